"""Studies of many recordings: manifest, parallel runs on Dask, table of trials, averaged curves, statistics and web
page.
"""
