"""Studies of many recordings: manifest, runs on Dask, table of trials, mean curves, statistics and web page."""
