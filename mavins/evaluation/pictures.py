"""matplotlib, set up once for drawing into files: a module that imports `plt` from here needs the extra `report`."""

import matplotlib as mpl

mpl.use("Agg")
from matplotlib import pyplot as plt

__all__ = ["plt"]
