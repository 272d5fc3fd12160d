"""Many independent jobs on any ``concurrent.futures.Executor``: batches, limits, and what became of each job."""

from dynident.jobs.engine import run_jobs
from dynident.jobs.job import Done, Limits, Status

__all__ = ["Done", "Limits", "Status", "run_jobs"]
