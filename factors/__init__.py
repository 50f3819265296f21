"""What each sensor says and how the vehicle moves: models, Jacobians and native GTSAM factors.

A residual here is numpy and takes a whole table: errors (N, m) with Jacobians (N, m, d). The
native factor beside it says the same to GTSAM; a test holds the two together. Pose tangents are
GTSAM's: rotation first, then translation, both in the vehicle frame.
"""
