"""How roots in object stores are named, and what is refused before anything is sent."""

import pickle
import sys
from pathlib import Path

import pytest

from tma_ray.results import ObjectStoreError, Store
from tma_ray.results.storage.bucket import ATTEMPTS, BucketStore

SECRET = "wJalrXUtnFEMI/K7MDENG+secret"


@pytest.fixture(autouse=True)
def environment(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("ENDPOINT_URL", "ENDPOINT_URL_S3", "REGION", "DEFAULT_REGION", "PROFILE"):
        monkeypatch.delenv(f"AWS_{name}", raising=False)
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "AKIAEXAMPLE")
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", SECRET)


@pytest.mark.parametrize(
    "uri",
    [
        f"s3://AKIAEXAMPLE:{SECRET}@bucket/folder",
        f"s3://AKIAEXAMPLE:{SECRET}",
        f"s3://:{SECRET}@bucket",
        "s3://wJalrXUtnFEMI@bucket/folder",
        f"gs://somebody:{SECRET}@bucket/folder",
        f"s3://bucket/folder?endpoint_override=http://me:{SECRET}@host",
    ],
)
def test_credentials_in_an_address_are_refused_and_not_repeated(uri: str) -> None:
    with pytest.raises(ValueError, match="must not hold credentials") as refused:
        Store.open(uri)
    assert "in the environment" in str(refused.value)
    for secret in (SECRET, "wJalrXUtnFEMI", "K7MDENG"):
        assert secret not in str(refused.value)


def test_a_parameter_that_holds_a_secret_is_refused_by_its_name_alone() -> None:
    with pytest.raises(ValueError, match=r"'secret_key'.*known are region, scheme") as refused:
        Store.open(f"s3://bucket/folder?secret_key={SECRET}")
    assert SECRET not in str(refused.value)


@pytest.mark.parametrize("uri", ["s3://", "gs:///folder"])
def test_a_bucket_is_needed(uri: str) -> None:
    with pytest.raises(ValueError, match="needs a bucket"):
        Store.open(uri)


ONE = {"AWS_ENDPOINT_URL": "http://one:1"}


@pytest.mark.parametrize(
    ("variables", "query", "endpoint", "region"),
    [
        ({"AWS_REGION": "eu-west-1"}, "", None, "eu-west-1"),
        ({"AWS_DEFAULT_REGION": "eu-west-2", "AWS_REGION": "eu-west-1"}, "", None, "eu-west-1"),
        ({"AWS_REGION": "eu-west-1"}, "?region=eu-north-1", None, "eu-north-1"),
        (ONE, "", "http://one:1", "us-east-1"),
        (ONE | {"AWS_ENDPOINT_URL_S3": "http://s:3"}, "", "http://s:3", "us-east-1"),
        (ONE, "?endpoint_override=http://u:4", "http://u:4", "us-east-1"),
    ],
)
def test_the_address_goes_before_the_environment(variables, query, endpoint, region, monkeypatch):
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    store = BucketStore.at(f"s3://bucket/some/folder/{query}")
    config = store._objects.config
    assert (store.base, config["region"], config.get("endpoint")) == ("bucket/some/folder", region, endpoint)


def test_a_travelling_store_carries_its_place_and_no_credentials(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:9")
    sent = pickle.dumps(Store.open("s3://bucket/a%20folder"))
    assert SECRET.encode() not in sent
    assert b"AKIAEXAMPLE" not in sent
    monkeypatch.delenv("AWS_ENDPOINT_URL")
    arrived = pickle.loads(sent)
    assert arrived._objects.config["endpoint"] == "http://127.0.0.1:9"
    assert str(arrived) == "s3://bucket/a folder"


def test_google_cloud_storage_is_addressed_alike_and_retries_for_as_long() -> None:
    store = Store.open("gs://bucket/some/folder")
    again = pickle.loads(pickle.dumps(store))
    for each in (store, again):
        assert each.full_path("tables/x") == "bucket/some/folder/tables/x"
        assert each.where("tables/x") == "gs://bucket/some/folder/tables/x"
        assert each._objects.retry_config["max_retries"] == ATTEMPTS - 1


@pytest.fixture
def aws_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with AWS's own two files, and no keys in the environment."""
    monkeypatch.delenv("AWS_ACCESS_KEY_ID")
    monkeypatch.setenv("AWS_REGION", "eu-west-1")
    for variable, name in (("AWS_CONFIG_FILE", "config"), ("AWS_SHARED_CREDENTIALS_FILE", "credentials")):
        monkeypatch.setenv(variable, str(tmp_path / name))
    return tmp_path


def keys(uri: str) -> tuple[str, str, str | None]:
    found = Store.open(uri)._objects.credential_provider()
    return found["access_key_id"], found["secret_access_key"], found["token"]


def test_keys_of_a_profile_come_from_files_of_aws(aws_files: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (aws_files / "credentials").write_text(
        "[default]\naws_access_key_id = one\naws_secret_access_key = 1%\n"
        "[work]\naws_access_key_id = two\naws_secret_access_key = 2\naws_session_token = t\n"
    )
    assert keys("s3://bucket/root") == ("one", "1%", None)
    monkeypatch.setenv("AWS_PROFILE", "work")
    assert keys("s3://bucket/root") == ("two", "2", "t")


def test_a_profile_may_name_a_process_of_keys(aws_files: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program = aws_files / "program.py"
    program.write_text('print(\'{"Version": 1, "AccessKeyId": "a", "SecretAccessKey": "b"}\')')
    text = f"[profile work]\ncredential_process = {sys.executable} {program}\n"
    (aws_files / "config").write_text(text)
    monkeypatch.setenv("AWS_PROFILE", "work")
    assert keys("s3://bucket/root") == ("a", "b", None)


@pytest.mark.parametrize(
    ("text", "message"),
    [("", "no such profile"), ("[profile work]\nrole_arn = x\n", "export-credentials --profile work")],
)
def test_a_profile_that_cannot_be_used_is_refused(aws_files, monkeypatch, text, message):
    (aws_files / "config").write_text(text)
    monkeypatch.setenv("AWS_PROFILE", "work")
    with pytest.raises(ObjectStoreError, match=message):
        Store.open("s3://bucket/root")
