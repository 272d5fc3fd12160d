"""``python -m dynident`` is the command ``dynident``; usage and advice name it as whoever started it says."""

import os

from dynident.cli import main

if __name__ == "__main__":
    main(prog_name=os.environ.get("DYNIDENT_COMMAND") or None)
