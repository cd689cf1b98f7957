"""Execution of attempts at runs, in processes of this machine or in Ray actors."""
