"""Storage in buckets of S3 and Google Cloud Storage."""

import configparser
import json
import os
import re
import shlex
import subprocess
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path
from textwrap import shorten
from typing import Any, Final
from urllib.parse import parse_qsl, unquote, urlencode, urlsplit

from tma_ray.results.storage.base import (
    CONTINUES,
    ObjectStoreError,
    ResultT,
    Stamp,
    StorageError,
    Store,
    Version,
    opened_ranges,
)
from tma_ray.support.decoding import MOST_TEXT_BYTES, check_size

ATTEMPTS: Final = 10  # attempts per request, with growing random pauses of about a minute in total

PARAMETERS: Final = {"s3": ("region", "scheme", "endpoint_override"), "gs": ("scheme", "endpoint_override")}
"""Query parameters that URIs may have, by scheme."""

_ADVICE: Final = {
    "NoSuchBucket": "the bucket does not exist; create it, or correct the root",
    "NoSuchUpload": "the upload was aborted by somebody else; run the same command again",
    "AccessDenied": "the credentials in the environment do not allow it; a root needs the rights to list, "
    "read, write and delete",
    "InvalidAccessKeyId": "the store does not know the credentials in the environment",
    "SignatureDoesNotMatch": "the secret key in the environment does not belong to the access key",
    "ExpiredToken": "the credentials in the environment have expired; renew them and run the same again",
}
_CREDENTIALS: Final = {
    "s3": "AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY (or a role)",
    "gs": "GOOGLE_APPLICATION_CREDENTIALS (or a role)",
}


class BucketStore(Store, schemes=("s3", "gs")):
    """Store in a folder of a bucket, written with atomic requests.

    Args:
        objects: store of obstore for the bucket.
        address: scheme, bucket and folder of the root, for messages.
        uri: address for other processes, without credentials.
    """

    is_object_store = True

    def __init__(self, objects: Any, address: str, uri: str = "") -> None:
        self._scheme, _, base = address.partition("://")
        super().__init__(base)
        self._folder = base.partition("/")[2]
        self._objects = objects
        self._uri = uri

    @classmethod
    def at(cls, uri: str) -> "BucketStore":
        """Return the store at ``s3://bucket/folder`` or ``gs://bucket/folder``.

        Credentials come from the environment. Region and endpoint are pickled with the store.
        """
        scheme, _, rest = uri.partition("://")
        start = re.split("[/?#]", rest)[0]
        # refuse colons, too: in a secret with a slash, everything from the slash on looks like a path
        if "@" in start or ":" in start or "@" in uri.partition("?")[2]:
            raise ValueError(
                f"a {scheme}:// root must not hold credentials, since roots are shown and logged: give "
                f"{scheme}://bucket/folder, and {_CREDENTIALS[scheme]} in the environment"
            )
        parts = urlsplit(uri)
        scheme, bucket = parts.scheme, parts.netloc
        if not bucket:
            raise ValueError(f"a {scheme}:// root needs a bucket: {scheme}://bucket/folder")
        options = dict(parse_qsl(parts.query, keep_blank_values=True))
        unknown = sorted(set(options) - set(PARAMETERS[scheme]))
        if unknown or parts.fragment:
            raise ValueError(
                f"{scheme}://{bucket} cannot take the parameter {(unknown or ['#'])[0]!r}; known are "
                f"{', '.join(PARAMETERS[scheme])}, and credentials belong in the environment"
            )
        if scheme == "s3":
            options = _s3_options(bucket, options)
        path = "/".join([bucket, *(name for name in unquote(parts.path).split("/") if name)])
        query = f"?{urlencode(options)}" if options else ""
        objects = _open(scheme, bucket, options)
        return cls(objects, f"{scheme}://{path}", f"{scheme}://{bucket}{parts.path}{query}")

    def __str__(self) -> str:
        return f"{self._scheme}://{self.base}"

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "_objects": None} if self._uri else vars(self)

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        if self._uri:
            self._objects = BucketStore.at(self._uri)._objects

    def _read(self, path: str, most_bytes: int) -> bytes:
        return self._get(path, most_bytes)[0]

    def read_version(self, path: str) -> tuple[bytes, Version]:
        data, meta = self._get(path, MOST_TEXT_BYTES)
        return data, {name: meta[name] for name in ("e_tag", "version") if meta.get(name)}

    def _get(self, path: str, most_bytes: int) -> tuple[bytes, Mapping[str, Any]]:
        with _explained(self.where(path)):
            answer = self._objects.get(self._key(path))
            check_size(self.where(path), answer.meta["size"], most_bytes)
            return bytes(answer.bytes()), answer.meta

    def _read_parts(self, path: str, read: Callable[[Any], ResultT]) -> ResultT:
        with _explained(self.where(path)):
            size = self._objects.head(self._key(path))["size"]

            def fetch(start: int, length: int) -> bytes:
                return bytes(self._objects.get_range(self._key(path), start=start, length=length))

            return read(opened_ranges(fetch, size))

    def write_bytes(self, path: str, data: bytes) -> None:
        with _explained(self.where(path)):
            self._objects.put(self._key(path), data, chunk_size=10 * 2**20)  # larger files are sent in parts

    def create(self, path: str, data: bytes) -> bool:
        return self._put_if(path, data, "create")

    def replace(self, path: str, data: bytes, version: Version) -> bool:
        return self._put_if(path, data, version)

    def _put_if(self, path: str, data: bytes, condition: Any) -> bool:
        from obstore.exceptions import AlreadyExistsError, PreconditionError

        with _explained(self.where(path)):
            try:
                self._objects.put(self._key(path), data, mode=condition)
            except (AlreadyExistsError, PreconditionError):
                return False
            return True

    def exists(self, path: str) -> bool:
        try:
            with _explained(self.where(path)):
                self._objects.head(self._key(path))
        except FileNotFoundError:
            return False
        return True

    def _stamps(self, folder: str = "") -> dict[str, Stamp]:
        with _explained(self.where(folder)):
            objects = {item["path"]: item for item in self._listed(folder)}
        parents = {path.rpartition("/")[0] for path in objects} | {self._prefix_of(folder)}
        start = len(self._folder) + 1 if self._folder else 0
        return {
            path[start:]: (int(item["last_modified"].timestamp() * 1e9), item["size"])
            for path, item in sorted(objects.items())
            if item["size"] or path not in parents  # other programs mark folders with empty objects
        }

    def _names(self, folder: str) -> set[str]:
        with _explained(self.where(folder)):
            listing = self._objects.list_with_delimiter(self._prefix_of(folder))
        paths = (*listing["common_prefixes"], *(item["path"] for item in listing["objects"]))
        return {path.rpartition("/")[2] for path in paths} - {""}

    def move(self, source: str, destination: str) -> None:
        with _explained(self.where(source)):
            self._objects.rename(self._key(source), self._key(destination))

    def delete(self, path: str) -> None:
        key = self._key(path)
        with _explained(self.where(path)):
            inner = [item["path"] for item in self._listed(path)]
            if inner:
                self._objects.delete(inner)
            with suppress(FileNotFoundError):
                self._objects.delete(key)

    def check_listable(self) -> None:
        self._names("")

    def _listed(self, folder: str) -> Iterator[Mapping[str, Any]]:
        return (item for batch in self._objects.list(self._prefix_of(folder)) for item in batch)

    def _key(self, path: str) -> str:
        """Return the key of `path` in the bucket."""
        return self.full_path(path).partition("/")[2]

    def _prefix_of(self, folder: str) -> str:
        return self._key(folder) if folder else self._folder


@contextmanager
def _explained(where: str) -> Iterator[None]:
    """Context manager that converts obstore's errors into errors with `where` and a remedy.

    Raises:
        FileNotFoundError: if the object is missing.
        ObjectStoreError: for all other errors, after all attempts.
    """
    from obstore.exceptions import BaseError

    try:
        yield
    except StorageError:
        raise
    except (BaseError, OSError) as error:
        text = str(error).partition("\n\nDebug source")[0]
        if isinstance(error, FileNotFoundError) and "NoSuchBucket" not in text:
            raise FileNotFoundError(f"{where} is not there") from error
        advices = (advice for code, advice in _ADVICE.items() if code in text)
        advice = next(advices, "the object store went on failing after all retries; " + CONTINUES)
        raise ObjectStoreError(f"{where}: {advice} ({shorten(text, 300)})") from error


def _s3_options(bucket: str, parameters: dict[str, str]) -> dict[str, str]:
    """Return a bucket's region and endpoint as given by its URI, the environment or AWS."""
    environment = os.environ.get
    endpoint = (
        parameters.get("endpoint_override")
        or environment("AWS_ENDPOINT_URL_S3")
        or environment("AWS_ENDPOINT_URL")
    )
    region = parameters.get("region") or environment("AWS_REGION") or environment("AWS_DEFAULT_REGION")
    if endpoint:
        scheme = {"scheme": parameters["scheme"]} if "scheme" in parameters else {}
        return {"region": region or "us-east-1", "endpoint_override": endpoint, **scheme}
    if region is None:
        from pyarrow import fs  # obstore cannot resolve regions

        with _explained(f"s3://{bucket}"):
            region = fs.resolve_s3_region(bucket)
    return {"region": region}


def _open(scheme: str, bucket: str, options: Mapping[str, str]) -> Any:
    """Return obstore's store for a bucket."""
    from obstore.store import GCSStore, S3Store

    endpoint = options.get("endpoint_override", "")
    if endpoint and "://" not in endpoint:
        endpoint = f"{options.get('scheme', 'https')}://{endpoint}"
    client: Any = {
        "allow_http": endpoint.startswith("http://"),
        "connect_timeout": timedelta(seconds=10),
        "read_timeout": timedelta(seconds=30),  # copies of large objects take a long time
        "timeout": timedelta(hours=1),  # for slow connections
    }
    # each pause is drawn uniformly between the first one and `base` times the previous one
    pauses = {"init_backoff": timedelta(seconds=0.5), "max_backoff": timedelta(seconds=20), "base": 3.5}
    retries: Any = {"max_retries": ATTEMPTS - 1, "retry_timeout": timedelta(hours=1), "backoff": pauses}
    config: Any = {"endpoint" if scheme == "s3" else "base_url": endpoint} if endpoint else {}
    if scheme == "gs":
        return GCSStore(bucket, config=config, client_options=client, retry_config=retries)
    provider: Any = _profile_credentials()
    config["region"] = options["region"]
    return S3Store(
        bucket, config=config, client_options=client, retry_config=retries, credential_provider=provider
    )


def _profile_credentials() -> Callable[[], dict[str, Any]] | None:
    """Return a function that reads keys from AWS's files, or None if obstore finds credentials itself."""
    environment = os.environ.get
    if any(environment(name) for name in ("AWS_ACCESS_KEY_ID", "AWS_WEB_IDENTITY_TOKEN_FILE")):
        return None
    name = environment("AWS_PROFILE", "default")
    if not _profile(name):
        if name == "default":
            return None
        raise ObjectStoreError(f"AWS_PROFILE={name}: AWS's own files have no such profile; correct it")
    if {"aws_access_key_id", "credential_process"}.isdisjoint(_profile(name)):
        if {"role_arn", "sso_session", "sso_start_url"}.isdisjoint(_profile(name)):
            return None
        raise ObjectStoreError(
            f"the profile {name!r} needs AWS's own tools: "
            f'eval "$(aws configure export-credentials --profile {name} --format env)" first'
        )
    return lambda: _keys(_profile(name))


def _profile(name: str) -> dict[str, str]:
    """Return the settings of a profile in AWS's configuration and credentials files."""
    settings: dict[str, str] = {}
    for variable, default, section in (
        ("AWS_CONFIG_FILE", "~/.aws/config", name if name == "default" else f"profile {name}"),
        ("AWS_SHARED_CREDENTIALS_FILE", "~/.aws/credentials", name),
    ):
        parser = configparser.RawConfigParser()
        parser.read(Path(os.environ.get(variable, default)).expanduser())
        if parser.has_section(section):
            settings |= dict(parser[section])
    return settings


def _keys(profile: Mapping[str, str]) -> dict[str, Any]:
    """Return the AWS credentials in `profile`, with their expiry, as obstore expects them."""
    expires: Any = datetime.now(UTC) + timedelta(minutes=5)  # after which the files are read again
    if "aws_access_key_id" in profile:
        names = "aws_access_key_id", "aws_secret_access_key", "aws_session_token"
        key, secret, token = (profile.get(name) for name in names)
    else:
        command = shlex.split(profile["credential_process"])
        answer = json.loads(subprocess.run(command, check=True, capture_output=True).stdout)  # noqa: S603
        key, secret, token = (answer.get(name) for name in ("AccessKeyId", "SecretAccessKey", "SessionToken"))
        if "Expiration" in answer:
            expires = datetime.fromisoformat(answer["Expiration"])
    return {"access_key_id": key, "secret_access_key": secret, "token": token, "expires_at": expires}
