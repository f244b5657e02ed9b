"""The command line: one file per command; only composes what the other rooms can do."""
