"""Looking at maps, in a browser and as pictures.

It needs the extra `ground`, which is not for the vehicle's computer.
"""
