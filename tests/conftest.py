"""Settings of all tests."""

import gc
import os
import signal
import threading

from hypothesis import Phase, settings

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy is loaded: with several workers, threads only wait
os.environ.setdefault("OMP_NUM_THREADS", "1")

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN and threading.current_thread() is threading.main_thread():
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell in the background ignores it, as would commands


def pytest_report_header() -> str:
    from dynident.runtime.kernel import kernel  # NumPy comes with the tests

    return f"kernel: {kernel()}"


def pytest_collection_finish() -> None:
    gc.collect()
    gc.freeze()  # ten thousand tests and all modules, which no later collection need go through


settings.register_profile("patient", deadline=None)  # a busy machine is no error
settings.register_profile("mutation", deadline=None, derandomize=True, phases=(Phase.explicit, Phase.generate))
settings.load_profile("patient")
