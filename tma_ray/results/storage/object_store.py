"""Buckets of S3 and Google Cloud Storage as file systems: addressing, credentials, retries, plain errors."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import timedelta
from random import SystemRandom
from typing import Any, Final, TypeVar
from urllib.parse import SplitResult, parse_qsl, unquote, urlencode, urlsplit

from pyarrow import fs

from tma_ray.decoding import check_size
from tma_ray.results.storage.errors import StorageError

T = TypeVar("T")

S3_ATTEMPTS: Final = 10
"""Tries of one request; the pauses double, are drawn at random up to 20 s, and last about a minute in all."""

GCS_RETRY_SECONDS: Final = 60
"""How long one request to Google Cloud Storage is tried again, s."""

MOST_PAUSE_SECONDS: Final = 20.0
"""Longest pause between two tries, s."""

REQUEST_SECONDS: Final = 30.0
"""Silence after which a request counts as lost, s: a store may take long to copy a large object."""

CONNECT_SECONDS: Final = 10.0
"""How long a connection may take, s."""

PARAMETERS: Final = {"s3": ("region", "scheme", "endpoint_override"), "gs": ("scheme", "endpoint_override")}
"""What a URI may say after its question mark."""

NO_BUCKET: Final = "the bucket does not exist; create it, or correct the root"

_ADVICE: Final = {
    "NO_SUCH_BUCKET": NO_BUCKET,
    "NO_SUCH_UPLOAD": "the upload was aborted by somebody else; run the same command again",
    "ACCESS_DENIED": "the credentials in the environment do not allow it; a root needs the rights to list, "
    "read, write and delete",
    "INVALID_ACCESS_KEY_ID": "the store does not know the credentials in the environment",
    "SIGNATURE_DOES_NOT_MATCH": "the secret key in the environment does not belong to the access key",
    "EXPIRED_TOKEN": "the credentials in the environment have expired; renew them and run the same again",
}
_CREDENTIALS: Final = {
    "s3": "AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY (or a role)",
    "gs": "GOOGLE_APPLICATION_CREDENTIALS (or a role)",
}


class ObjectStoreError(StorageError, ConnectionError):
    """An object store refused a request or went on failing; the message names the file and a remedy."""


class ReplacedWhileReadError(OSError):
    """An object is not the one any more whose size was asked for: the bytes may be those of half of it."""


def read_object(filesystem: Any, path: str, where: str, most_bytes: int) -> bytes:
    """Returns the bytes of one version of an object.

    Args:
        filesystem: that of its bucket.
        path: bucket and key.
        where: its address, for messages.
        most_bytes: size over which it is refused.

    Raises:
        DamagedFileError: it has more bytes.
        ReplacedWhileReadError: another version came meanwhile.
    """
    with filesystem.open_input_file(path) as file:
        check_size(where, file.size(), most_bytes)
        data: bytes = file.read()
        version = file.metadata()
    # The size is asked for before the bytes: of an object that grew in between, only as many came.
    with filesystem.open_input_file(path) as file:
        if file.metadata() != version:
            raise ReplacedWhileReadError
    return data


def open_bucket(uri: str) -> tuple[Any, str, str]:
    """Opens ``s3://bucket/folder`` or ``gs://bucket/folder`` with credentials of the environment.

    Returns:
        The file system, the path of the root in it, and a URI that leads another process there: with
        the region and the endpoint found here, without credentials.

    Raises:
        ValueError: a URI with credentials, without bucket or with a parameter that is none of `PARAMETERS`.
        ObjectStoreError: the region of the bucket cannot be found out.
    """
    _refuse_credentials(uri)
    parts = urlsplit(uri)
    options = _parameters(parts)
    path = "/".join([parts.netloc, *(name for name in unquote(parts.path).split("/") if name)])
    if parts.scheme == "s3":
        options = _s3_options(parts.netloc, options)
        filesystem = _s3(options)
    else:
        retry_time = timedelta(seconds=GCS_RETRY_SECONDS)
        filesystem = fs.GcsFileSystem(retry_time_limit=retry_time, **options)
    query = f"?{urlencode(options)}" if options else ""
    return filesystem, path, f"{parts.scheme}://{parts.netloc}{parts.path}{query}"


def unwritable(error: Exception) -> str:
    """Returns why a first file could not be written."""
    if isinstance(error, NotImplementedError):
        return "results at an address of this kind can only be read"
    return f"{NO_BUCKET} ({error})"


def patiently(read: Callable[[], T]) -> T:
    """Repeats a read that may be torn or that pyarrow gives up too early; returns what it returns at last.

    A refusal that is longer than the object does not fit into the place made for it: pyarrow then does
    not see that it was one. The pauses are like those of `S3_ATTEMPTS`.

    Raises:
        OSError: of any other kind, or of these kinds in the end.
    """
    for attempt in range(S3_ATTEMPTS - 1):
        try:
            return read()
        except ReplacedWhileReadError:
            pass
        except OSError as error:
            if "Failed to flush response stream" not in str(error):
                raise
        time.sleep(SystemRandom().uniform(0.0, min(2.0**attempt, MOST_PAUSE_SECONDS)))
    return read()


@contextmanager
def explained(where: str) -> Iterator[None]:
    """Turns what pyarrow raises within the block into errors that name `where` and say what to do.

    Raises:
        FileNotFoundError: as it came, or the source of a copy is not there.
        ObjectStoreError: everything else that the store answered, after all tries.
    """
    try:
        yield
    except FileNotFoundError:
        raise
    except OSError as error:
        text = str(error)
        if "NO_SUCH_KEY" in text:
            raise FileNotFoundError(f"{where} is not there: {text}") from error
        raise ObjectStoreError(f"{where}: {_advice(text)} ({text})") from error


def _refuse_credentials(uri: str) -> None:
    scheme, _, rest = uri.partition("://")
    bucket = re.split("[/?#]", rest)[0]
    # A colon is enough: a secret may hold a slash, after which the rest of it looks like a path.
    if "@" in bucket or ":" in bucket or "@" in uri.partition("?")[2]:
        raise ValueError(
            f"a {scheme}:// root must not hold credentials, since roots are shown and logged: give "
            f"{scheme}://bucket/folder, and {_CREDENTIALS[scheme]} in the environment"
        )


def _parameters(parts: SplitResult) -> dict[str, str]:
    if not parts.netloc:
        raise ValueError(f"a {parts.scheme}:// root needs a bucket: {parts.scheme}://bucket/folder")
    given = dict(parse_qsl(parts.query, keep_blank_values=True))
    unknown = sorted(set(given) - set(PARAMETERS[parts.scheme]))
    if unknown or parts.fragment:
        raise ValueError(
            f"{parts.scheme}://{parts.netloc} cannot take the parameter {(unknown or ['#'])[0]!r}; known are "
            f"{', '.join(PARAMETERS[parts.scheme])}, and credentials belong in the environment"
        )
    return given


def _s3_options(bucket: str, given: dict[str, str]) -> dict[str, str]:
    """Returns where the bucket is: as the URI says, else the environment, else as AWS itself says."""
    environment = os.environ.get
    endpoint = (
        given.get("endpoint_override")
        or environment("AWS_ENDPOINT_URL_S3")
        or environment("AWS_ENDPOINT_URL")
    )
    region = given.get("region") or environment("AWS_REGION") or environment("AWS_DEFAULT_REGION")
    if endpoint:
        scheme = {"scheme": given["scheme"]} if "scheme" in given else {}
        return {"region": region or "us-east-1", "endpoint_override": endpoint, **scheme}
    if region is None:
        with explained(f"s3://{bucket}"):
            region = fs.resolve_s3_region(bucket)
    return {"region": region}


def _s3(options: dict[str, str]) -> Any:
    return fs.S3FileSystem(
        **options,
        retry_strategy=fs.AwsStandardS3RetryStrategy(max_attempts=S3_ATTEMPTS),
        request_timeout=REQUEST_SECONDS,
        connect_timeout=CONNECT_SECONDS,
        allow_delayed_open=True,  # a small object is one PUT, instead of an upload in parts
        # In the foreground, closing a large upload one of whose parts has failed would publish the rest.
        background_writes=True,
    )


def _advice(text: str) -> str:
    for code, advice in _ADVICE.items():
        if code in text:
            return advice
    return (
        "the object store went on failing after all retries; what was published before is safe, and the same "
        "command continues from there"
    )
