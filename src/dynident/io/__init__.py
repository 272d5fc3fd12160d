"""The only room that opens files: measured logs, configurations and models in; results out."""
