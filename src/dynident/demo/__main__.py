"""``python -m dynident.demo FOLDER`` makes the demo arm's files anew; those that are shipped lie in ``files``."""

from __future__ import annotations

import sys
from pathlib import Path

from dynident.demo.shipped import made_files
from dynident.io.results import write_bytes

if __name__ == "__main__":
    if len(sys.argv) != 2 or sys.argv[1].startswith("-"):
        sys.exit(__doc__)
    for name, data in made_files().items():
        write_bytes(Path(sys.argv[1]) / name, data)
