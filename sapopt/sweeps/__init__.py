"""Sweeps: many jobs (seeds x instances x solvers, bounds, training seeds) over processes or a Dask cluster.

`run_jobs` takes any function of a dictionary; `read_config` and `solve_job` are what ``sapopt sweep`` does with it.
"""

from sapopt.sweeps.config import Sweep, read_config
from sapopt.sweeps.engine import Finished, Job, run_jobs
from sapopt.sweeps.work import solve_job

__all__ = ["Finished", "Job", "Sweep", "read_config", "run_jobs", "solve_job"]
