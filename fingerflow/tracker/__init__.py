"""The tracker: the one policy from frame to frame, in NumPy, for recordings and for streams.

It decides where points are expected, when templates are updated, how lost points are recovered and verified, whether a
frame is usable, when a point comes into contact and how, and where points are seeded. An engine (`fingerflow.engines`)
computes what it asks for. What a stream cannot know, because frames are yet to come, is an argument.
"""
