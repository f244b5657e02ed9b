"""The first example may compile a kernel: no deadline; and the same examples in every run."""

from hypothesis import settings

settings.register_profile("kernels", deadline=None, derandomize=True)
settings.load_profile("kernels")
