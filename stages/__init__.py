"""What is done to a capture: pure functions of arrays, one verb a file."""
