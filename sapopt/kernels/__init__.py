"""Compiled kernels (numba). Imported only where they are first needed, so that `import sapopt` stays light."""
