"""The two ways in which attempts at runs are executed: processes of this machine, and Ray actors."""
