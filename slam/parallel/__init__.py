"""Workers beyond the threads of the command: processes of this machine, and those of a cluster."""
