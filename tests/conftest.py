"""Settings of all tests."""

import gc
import os
import shutil
import signal
import threading

from hypothesis import Phase, settings

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy is loaded: with several workers, threads only wait
os.environ.setdefault("OMP_NUM_THREADS", "1")

MEMORY = "/dev/shm"  # a folder in memory, on Linux: tests that write many files take a third less there
if os.access(MEMORY, os.W_OK) and shutil.disk_usage(MEMORY).free > 4e9:
    os.environ.setdefault("PYTEST_DEBUG_TEMPROOT", MEMORY)

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN and threading.current_thread() is threading.main_thread():
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell in the background ignores it, as would commands


def pytest_report_header() -> str:
    from dynident.runtime.kernel import kernel  # NumPy comes with the tests

    return f"kernel: {kernel()}"


def pytest_collection_finish() -> None:
    gc.collect()
    gc.freeze()  # ten thousand tests and all modules, which no later collection need go through
    gc.set_threshold(10_000, 20, 20)  # a collection costs more than what it frees


settings.register_profile("patient", deadline=None)  # a busy machine is no error
settings.register_profile("mutation", deadline=None, derandomize=True, phases=(Phase.explicit, Phase.generate))
settings.load_profile("patient")
