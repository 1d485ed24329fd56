"""The command line: one command a file; computing is done by the library."""
