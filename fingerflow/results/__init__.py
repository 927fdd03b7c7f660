"""Storage and export of results: in memory, in HDF5 files, in folders of a stream, and as tables for other programs."""
