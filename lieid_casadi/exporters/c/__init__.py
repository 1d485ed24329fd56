"""C code for a controller."""
