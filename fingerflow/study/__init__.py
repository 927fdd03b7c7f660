"""Many recordings: manifest, run on Dask, table of trials, averaged curves, statistics and an index page."""
