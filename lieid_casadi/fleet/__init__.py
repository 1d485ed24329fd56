"""Many arms, every night: recordings diagnosed on a Dask cluster, trends and alarms in a file."""
