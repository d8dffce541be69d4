"""The command line: `main.py` lists the verbs, and each has a file of its own with its options (`add_options`) and `run`."""

PROGRAM = "avatarrex-studio"
