"""Parts of the tracker that need later frames or OpenCV and SciPy, which a lab PC with a stream does not have."""
