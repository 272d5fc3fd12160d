"""The only package that opens files: it reads logs, configurations and models, and writes results."""
