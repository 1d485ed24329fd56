"""Statistics over nights: scatter, changes, repeated findings."""
