"""The command line: one command per file, which calls the library."""
