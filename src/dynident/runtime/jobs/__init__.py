"""Many independent pieces of work, on any executor: each becomes a value, or a reason why there is none."""

from dynident.runtime.jobs.engine import run_jobs
from dynident.runtime.jobs.job import FAILURES, JobOptions, JobResult, Limits, Status
from dynident.runtime.jobs.workers import local_workers
