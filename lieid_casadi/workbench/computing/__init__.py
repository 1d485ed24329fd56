"""What the worker processes compute."""
