"""Where drives come from: folders, real samples, simulated scenarios, recordings of others.

Importing this package is cheap; readers and scenarios are imported when they are used.
"""

from fgloc.datasets.registry import DatasetInfo, available, import_recording, make, open_drive

__all__ = ["DatasetInfo", "available", "import_recording", "make", "open_drive"]
