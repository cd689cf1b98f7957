"""Addresses of Ray clusters."""

import os
import re
import socket
from typing import Final

PROBE_SECONDS: Final = 5.0  # longest wait for a connection to an address, s

_HOST: Final = re.compile(r"[\w.-]+|[0-9a-fA-F:.]*:[0-9a-fA-F:.]+(%\w+)?")
"""Pattern of a host name or an IP address."""


def check_address(address: str) -> None:
    """Check that a campaign could join a cluster at this address.

    Args:
        address: "host:port" of a cluster's head, or "auto": RAY_ADDRESS if set, else the Ray on this
            machine, which Ray finds itself.

    Raises:
        ValueError: if the address is malformed.
        ConnectionError: if nothing listens there.
    """
    if address == "auto":
        address = os.environ.get("RAY_ADDRESS") or "auto"
    head = host_and_port(address)
    if head is None:
        return
    try:
        socket.create_connection(head, timeout=PROBE_SECONDS).close()
    except OSError as error:
        raise ConnectionError(connection_advice(address, f"nothing listens there ({error})")) from error


def host_and_port(address: str) -> tuple[str, int] | None:
    """Return the host and port of a cluster's head, or None for "auto".

    Raises:
        ValueError: if the address is malformed.
    """
    if address == "auto":
        return None
    if "://" in address:
        raise ValueError(
            f"address {address!r} is for Ray's own tools, and no campaign can run through it: its driver "
            f"belongs on the cluster, where its address is 'auto'; get it there with "
            f"'ray job submit --address http://127.0.0.1:8265 -- python SCRIPT --address auto'"
        )
    host, separator, port = address.rpartition(":")
    host = host.strip("[]")
    if not (separator and _HOST.fullmatch(host) and port.isdecimal() and 0 < int(port) < 2**16):
        raise ValueError(
            f"address {address!r}: expected 'auto' or the head's 'host:port', as in 10.0.0.5:6379"
        )
    return host, int(port)


def connection_advice(address: str, reason: str) -> str:
    """Return a message on a failed connection to `address`, with its cause and remedies."""
    return (
        f"no Ray cluster was joined at {address!r}: {reason}. From one of its nodes use '--address auto'; "
        f"from elsewhere submit the campaign instead ('ray job submit', 'ray submit'). A cluster that asks "
        f"for a token needs RAY_AUTH_MODE=token and its own ~/.ray/auth_token (or RAY_AUTH_TOKEN_PATH). "
        f"'--local' needs no cluster"
    )
