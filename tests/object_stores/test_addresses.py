"""How roots in object stores are named, and what is refused before anything is sent."""

import pickle
from datetime import timedelta

import pytest

from tma_ray.results import Store
from tma_ray.results.storage.object_store import GCS_RETRY_SECONDS, S3_ATTEMPTS, open_bucket

SECRET = "wJalrXUtnFEMI/K7MDENG+secret"


@pytest.fixture(autouse=True)
def environment(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("AWS_ENDPOINT_URL", "AWS_ENDPOINT_URL_S3", "AWS_REGION", "AWS_DEFAULT_REGION"):
        monkeypatch.delenv(name, raising=False)
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


@pytest.mark.parametrize(
    ("variables", "query", "endpoint", "region"),
    [
        ({"AWS_REGION": "eu-west-1"}, "", "", "eu-west-1"),
        ({"AWS_DEFAULT_REGION": "eu-west-2", "AWS_REGION": "eu-west-1"}, "", "", "eu-west-1"),
        ({"AWS_REGION": "eu-west-1"}, "?region=eu-north-1", "", "eu-north-1"),
        ({"AWS_ENDPOINT_URL": "http://one:1"}, "", "http://one:1", "us-east-1"),
        (
            {"AWS_ENDPOINT_URL": "http://one:1", "AWS_ENDPOINT_URL_S3": "http://s:3"},
            "",
            "http://s:3",
            "us-east-1",
        ),
        ({"AWS_ENDPOINT_URL": "http://one:1"}, "?endpoint_override=http://u:4", "http://u:4", "us-east-1"),
    ],
)
def test_the_address_goes_before_the_environment(
    variables: dict[str, str], query: str, endpoint: str, region: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    filesystem, base, _ = open_bucket(f"s3://bucket/some/folder/{query}")
    _, (settings,) = filesystem.__reduce__()
    assert (base, filesystem.region, settings["endpoint_override"]) == (
        "bucket/some/folder",
        region,
        endpoint,
    )


def test_a_travelling_store_carries_its_place_and_no_credentials(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:9")
    sent = pickle.dumps(Store.open("s3://bucket/a%20folder"))
    assert SECRET.encode() not in sent
    assert b"AKIAEXAMPLE" not in sent
    monkeypatch.delenv("AWS_ENDPOINT_URL")
    arrived = pickle.loads(sent)
    _, (settings,) = arrived.filesystem.__reduce__()
    assert settings["endpoint_override"] == "http://127.0.0.1:9"
    assert settings["background_writes"], "else a large upload that fails leaves a truncated object"
    assert settings["allow_delayed_open"], "else a small object takes three requests"
    assert str(arrived) == "s3://bucket/a folder"


def test_google_cloud_storage_is_addressed_alike_and_retries_for_as_long() -> None:
    store = Store.open("gs://bucket/some/folder")
    again = pickle.loads(pickle.dumps(store))
    for each in (store, again):
        assert each.full_path("tables/x") == "bucket/some/folder/tables/x"
        assert each.where("tables/x") == "gs://bucket/some/folder/tables/x"
        _, (settings,) = each.filesystem.__reduce__()
        assert settings["retry_time_limit"] == timedelta(seconds=GCS_RETRY_SECONDS)
    assert S3_ATTEMPTS > 5
