"""`python -m pipeline` is the command `sixlight`."""

from pipeline.cli import main

main()
