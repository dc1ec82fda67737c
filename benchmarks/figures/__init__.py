"""The paper's figures from the bundled capture, and those it had no room for: docs/figures.md."""
