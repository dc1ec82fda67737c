"""Tests in a real browser: `make test-browser`. A package, so that conftest has its own name."""
