"""Errors of the Ray that a campaign runs on; importing them imports no Ray."""


class HeadLostError(RuntimeError):
    """Ray's head has died, was stopped, or did not answer for as long as Ray waits for it."""
