"""Machine code of the kernels: kept on disk, read back without numba's compiler, compiled by several processes at once.
"""
