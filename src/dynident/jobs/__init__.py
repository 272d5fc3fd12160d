"""Many independent jobs on any ``concurrent.futures.Executor``: batches, limits, and what became of each job."""

from dynident.jobs.engine import run_jobs
from dynident.jobs.job import Done, Limits, Status
from dynident.jobs.workers import local_workers

__all__ = ["Done", "Limits", "Status", "local_workers", "run_jobs"]
