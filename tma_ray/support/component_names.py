"""The grammar of names with settings, ``name:key=value``.

Settings follow the name of a part, as in ``alp_gmm:fit_every=100``, ``stock:sac:learning_rate=3e-4`` or
``module:Name:key=value``. Lists are written with "x" between their entries (``hidden_units=64x64``), or as
JSON where an entry is a list or has an "x" itself; mappings as JSON, booleans as ``true`` and ``false``, no
value as ``none``; ":", "=", "," and "%" within a value are escaped as in addresses (``%3A``). The canonical
name of a part holds what differs from its defaults and nothing else, with sorted keys, so that equal parts
have equal names wherever they are compared.
"""

import difflib
import json
import re
from collections.abc import Iterable, Mapping
from typing import Any
from urllib.parse import unquote

SETTINGS = re.compile(r"(:\w+=[^:=]*)+$")  # the settings at the end of a name
FILE = re.compile(r"\.py:(\w+)$")  # the end of a plug-in that is named by its file, before its settings
LIST_SEPARATOR = "x"  # between the entries of a list; commas separate names

ESCAPES = str.maketrans({character: f"%{ord(character):02X}" for character in ":=,%"})
"""How characters are written within a value that mean something in a name."""


def split_name(text: str) -> tuple[str, dict[str, str]]:
    """Return the name of a part without its settings, and the settings as text.

    Raises:
        ValueError: a setting is given twice.

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
    """Return the name of a part without its settings; a file ``module.py:Name`` as its module.

    Examples:
        >>> base_name("alp_gmm:fit_every=10"), base_name("module:Name"), base_name("module.py:Name")
        ('alp_gmm', 'module:Name', 'module:Name')
    """
    return _parted(text)[0]


def _parted(text: str) -> tuple[str, str]:
    """Return the name of a part and the text of its settings, with the colon before it."""
    if not isinstance(text, str):
        raise TypeError(f"{text!r:.60}: expected the name of a part, as 'random'")
    match = SETTINGS.search(text)
    end = len(text) if match is None else match.start()
    return FILE.sub(r":\1", text[:end]), text[end:]


def nearest(name: str, known: Iterable[str]) -> str:
    """Return a hint at the known name that is most like `name`, empty if none is like it.

    Examples:
        >>> nearest("Alp_gm", ["random", "alp_gmm"])
        "did you mean 'alp_gmm'? "
    """
    by_lower_case = {str(each).lower(): str(each) for each in known}
    found = difflib.get_close_matches(name.lower(), by_lower_case, n=1)
    return f"did you mean {by_lower_case[found[0]]!r}? " if found else ""


def join_name(name: str, settings: Mapping[str, Any]) -> str:
    """Return `name` with `settings`, sorted by key; the reverse of `split_name`.

    Examples:
        >>> join_name("sac", {"learning_rate": 3e-4, "hidden_units": (64, 64), "batch_size": 100.0})
        'sac:batch_size=100:hidden_units=64x64:learning_rate=0.0003'
    """
    return name + "".join(f":{key}={text_of(settings[key]).translate(ESCAPES)}" for key in sorted(settings))


def text_of(value: Any) -> str:
    """Return a value as it is written in a name.

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
    """True if an entry of a list would not be read again between separators."""
    if isinstance(item, str):
        return not item or LIST_SEPARATOR in item or item.startswith(("[", "{"))
    return isinstance(item, (tuple, list, dict))
