"""Which object that a node broadcasts is which that the car sees, and where that puts the car.

Two sets of points in the plane: objects in world axes as a node tells them, and objects in the
car's axes, the car itself among them at 0. Khamooshi (2023), section 4.2: `icp` and `cpd`, each as
printed and mended, warm start and dummies for what the car cannot see. `match` is ours: it looks at
every rotation that two pairs can agree on, and says 'ambiguous' where the layout leaves a choice.
"""

from fgloc.correspondence.cpd import cpd
from fgloc.correspondence.dummies import with_dummies
from fgloc.correspondence.icp import icp
from fgloc.correspondence.matching import match
from fgloc.correspondence.oracle import is_ambiguous
from fgloc.correspondence.rigid import IDENTITY, Correspondence, Rigid, Status, fit

__all__ = [
    "IDENTITY",
    "Correspondence",
    "Rigid",
    "Status",
    "cpd",
    "fit",
    "icp",
    "is_ambiguous",
    "match",
    "with_dummies",
]
