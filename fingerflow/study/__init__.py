"""Studies of many recordings: manifest, runs on Dask, table of trials, averaged curves, statistics and index page."""
