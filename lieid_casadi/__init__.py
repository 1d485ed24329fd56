"""Dynamic models of serial robot arms: identify them, see where they fail, learn what is missing."""
