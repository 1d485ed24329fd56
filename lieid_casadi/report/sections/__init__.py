"""One section of a report a file, its template beside it."""
