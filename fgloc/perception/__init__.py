"""Pixels to measurements: the map of a roadside camera, and codes read in images.

No files, no drives: arrays in, arrays out. What needs OpenCV imports it where it is used.
"""
