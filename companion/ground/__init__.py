"""The operator's side: looking at maps, in a browser and as a picture.

It needs the extra `ground`, which is not for the vehicle's computer.
"""
