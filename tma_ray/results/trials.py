"""The trial of a results root: its design, fixed before its first run, and what each look said."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Final

from tma_ray.decoding import Natural, decode_json
from tma_ray.results.storage import Store

TRIAL_FILE: Final = "trial.json"
FORMAT: Final = "tma_ray trial"


@dataclass(frozen=True)
class TrialLook:
    """A look at a trial.

    Attributes:
        seeds: number of seeds of every cell.
        said: verdicts in a sentence.
    """

    seeds: Natural
    said: str


@dataclass(frozen=True)
class TrialFile:
    """The content of `TRIAL_FILE`.

    Attributes:
        design: what was fixed beforehand.
        looks: looks so far.
        ended: why it ended; empty while it goes on.
        format: kind of the file.
    """

    design: Mapping[str, Any]
    looks: tuple[TrialLook, ...] = ()
    ended: str = ""
    format: str = FORMAT

    @classmethod
    def load(cls, store: Store) -> TrialFile | None:
        """Returns the trial of a root, None if it has none.

        Raises:
            DamagedFileError: it is not what was written.
        """
        if not store.holds(TRIAL_FILE):
            return None
        return decode_json(store.read_bytes(TRIAL_FILE), cls, store.where(TRIAL_FILE))

    def save(self, store: Store) -> None:
        """Writes it in one piece."""
        store.write_bytes(TRIAL_FILE, (json.dumps(asdict(self), indent=1) + "\n").encode())
