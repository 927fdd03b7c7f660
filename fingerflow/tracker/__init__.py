"""Tracking of points through frames, contact onset and frame quality, in NumPy, for recordings and for streams.

It predicts positions, updates templates, recovers lost points, verifies their subsets, checks whether frames are
usable, determines when and how a point comes into contact, and seeds points. An engine (`fingerflow.engines`) does the
computation. Arguments state what a stream cannot know because later frames are missing.
"""
