"""Grammar of component names with settings, ``name:key=value``.

Settings follow the name of a component, as in ``alp_gmm:fit_every=100``, ``stock:sac:learning_rate=3e-4`` or
``module:Name:key=value``. List entries are separated by "x" (``hidden_units=64x64``), unless an entry is a
list or contains an "x": such lists, and mappings, are written as JSON. Booleans are ``true`` and ``false``,
and None is ``none``. The characters ":", "=", "," and "%" in values are percent-encoded (``%3A``). The
canonical name of a component has only settings that differ from its defaults, sorted by key, so that equal
components have equal names.
"""

import difflib
import json
import re
from collections.abc import Iterable, Mapping
from typing import Any
from urllib.parse import unquote

_SETTINGS = re.compile(r"(:\w+=[^:=]*)+$")  # settings at the end of a name
_FILE = re.compile(r"\.py:(\w+)$")  # end of a plug-in's name given with a file name, as in module.py:Name
LIST_SEPARATOR = "x"  # separates list entries, since commas separate names

ESCAPES = str.maketrans({character: f"%{ord(character):02X}" for character in ":=,%"})
"""Percent-encoding of special characters in values."""


def split_name(text: str) -> tuple[str, dict[str, str]]:
    """Return a component's name without settings, and the values of its settings as strings, by key.

    Raises:
        ValueError: if a setting occurs twice.

    Examples:
        >>> split_name("stock:sac:learning_rate=3e-4")
        ('stock:sac', {'learning_rate': '3e-4'})
        >>> split_name("module:Name")
        ('module:Name', {})
    """
    base, settings = _parted(text)
    pairs = [setting.split("=") for setting in settings.split(":")[1:]]
    keys = [key for key, _ in pairs]
    for key in keys:
        if keys.count(key) > 1:
            raise ValueError(f"{text!r}: {key} is given {keys.count(key)} times; give it once")
    return base, {key: unquote(value.strip()) for key, value in pairs}


def base_name(text: str) -> str:
    """Return a component's name without settings, writing ``module.py:Name`` as ``module:Name``.

    Examples:
        >>> base_name("alp_gmm:fit_every=10"), base_name("module:Name"), base_name("module.py:Name")
        ('alp_gmm', 'module:Name', 'module:Name')
    """
    return _parted(text)[0]


def _parted(text: str) -> tuple[str, str]:
    """Return a component's name, and its settings as a string with the leading colon."""
    if not isinstance(text, str):
        raise TypeError(f"{text!r:.60}: expected the name of a part, as 'random'")
    match = _SETTINGS.search(text)
    end = len(text) if match is None else match.start()
    return _FILE.sub(r":\1", text[:end]), text[end:]


def nearest(name: str, candidates: Iterable[str]) -> str:
    """Return a hint that suggests the candidate closest to `name`, or an empty string if none is close.

    Examples:
        >>> nearest("Alp_gm", ["random", "alp_gmm"])
        "did you mean 'alp_gmm'? "
    """
    by_lower_case = {str(candidate).lower(): str(candidate) for candidate in candidates}
    matches = difflib.get_close_matches(name.lower(), by_lower_case, n=1)
    return f"did you mean {by_lower_case[matches[0]]!r}? " if matches else ""


def join_name(name: str, settings: Mapping[str, Any]) -> str:
    """Return `name` with `settings` sorted by key; the inverse of `split_name`.

    Examples:
        >>> join_name("sac", {"learning_rate": 3e-4, "hidden_units": (64, 64), "batch_size": 100.0})
        'sac:batch_size=100:hidden_units=64x64:learning_rate=0.0003'
    """
    return name + "".join(f":{key}={text_of(settings[key]).translate(ESCAPES)}" for key in sorted(settings))


def text_of(value: Any) -> str:
    """Return the string that represents a value in a name.

    Examples:
        >>> [text_of(value) for value in (1.0, 3e-4, True, None, (64, 64), ["box"])]
        ['1', '0.0003', 'true', 'none', '64x64', '["box"]']
    """
    if value is None or isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return repr(value).removesuffix(".0")
    if isinstance(value, dict) or (isinstance(value, (tuple, list)) and any(map(_needs_quotes, value))):
        return json.dumps(value, separators=(",", ":"))
    if isinstance(value, (tuple, list)):
        return LIST_SEPARATOR.join(map(text_of, value))
    return str(value)


def _needs_quotes(item: Any) -> bool:
    """Return True if a list that contains `item` must be written as JSON."""
    if isinstance(item, str):
        return not item or LIST_SEPARATOR in item or item.startswith(("[", "{"))
    return isinstance(item, (tuple, list, dict))
