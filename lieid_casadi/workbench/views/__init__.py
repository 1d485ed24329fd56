"""Views of the page, one a file; each shows a `Workbench` and calls its methods."""
