"""The manifest for KubeRay, held against what its reference says of the fields, and the image's recipe."""

from __future__ import annotations

import importlib.metadata
import re
from pathlib import Path
from typing import Any

import jsonschema
import pytest
import yaml
from kuberay_schema import JOB, KUBERAY
from test_cluster_yaml import CONFIG, locked

import tma_ray
from tma_ray import cli
from tma_ray.campaign.settings import GIB, Resources
from tma_ray.command_line import read

DEPLOY = Path(__file__).parents[2] / "deploy"
CLAIM, MANIFEST = yaml.safe_load_all((DEPLOY / "kuberay.yaml").read_text())
CLUSTER: dict[str, Any] = MANIFEST["spec"]["rayClusterSpec"]
GROUPS: dict[str, dict[str, Any]] = {group["groupName"]: group for group in CLUSTER["workerGroupSpecs"]}
DOCKERFILE = (DEPLOY / "Dockerfile").read_text()


def pods() -> list[dict[str, Any]]:
    return [each["template"]["spec"] for each in (CLUSTER["headGroupSpec"], *GROUPS.values())]


def test_the_manifest_has_fields_that_kuberay_knows_and_a_slip_would_be_found() -> None:
    jsonschema.validate(MANIFEST, JOB)
    slip = {**MANIFEST, "spec": {**MANIFEST["spec"], "backoffLimits": 3}}
    with pytest.raises(jsonschema.ValidationError, match="backoffLimits"):
        jsonschema.validate(slip, JOB)
    assert f"KubeRay {KUBERAY}" in (DEPLOY.parent / "docs" / "kubernetes.md").read_text()


def test_groups_hold_what_the_nodes_on_aws_hold() -> None:
    for name, group in GROUPS.items():
        params = group["rayStartParams"]
        (container,) = group["template"]["spec"]["containers"]
        memory = int(container["resources"]["requests"]["memory"].removesuffix("Gi")) * GIB
        offers = {"CPU": float(params["num-cpus"]), "GPU": float(params.get("num-gpus", 0)), "memory": memory}
        on_aws = CONFIG["available_node_types"][f"{name}_worker"]["resources"]
        assert Resources().fit_into(offers) == Resources().fit_into(on_aws) == 16
        assert (group["minReplicas"], group["replicas"]) == (0, 0)
        assert container["resources"]["limits"].get("nvidia.com/gpu", "0") == params.get("num-gpus", "0")
    assert CLUSTER["headGroupSpec"]["rayStartParams"]["num-cpus"] == "0"
    assert CLUSTER["rayVersion"] == locked("cluster.lock")["ray"] == importlib.metadata.version("ray")


def test_pods_are_not_root_ask_for_the_token_and_see_the_results() -> None:
    assert CLUSTER["authOptions"] == {"mode": "token"}
    for pod in pods():
        assert pod["securityContext"] == {"runAsNonRoot": True, "runAsUser": 1000, "fsGroup": 1000}
        (container,) = pod["containers"]
        assert {mount["mountPath"] for mount in container["volumeMounts"]} == {"/results", "/dev/shm"}
        assert pod["volumes"][0]["persistentVolumeClaim"]["claimName"] == CLAIM["metadata"]["name"]
        assert f":{tma_ray.__version__}-" in container["image"]


def test_the_entry_point_is_a_command_that_may_be_repeated() -> None:
    found = re.search(r"python experiments/(\w+)\.py (.*)'", MANIFEST["spec"]["entrypoint"])
    assert found is not None
    assert (DEPLOY.parent / "experiments" / f"{found[1]}.py").is_file()
    call = read(cli.app(), [found[1], *found[2].split()])
    options = call.keywords["options"]
    assert (options.address, options.autoscaling, options.yes) == ("auto", True, True)
    assert options.results.startswith("/results/")
    assert MANIFEST["spec"]["backoffLimit"] > 0
    assert "sleep 120" in MANIFEST["spec"]["entrypoint"], (
        "the root of a campaign that was killed is held so long"
    )


def test_the_image_has_this_version_one_layer_of_locked_packages_and_no_root() -> None:
    assert f"tma_ray-{tma_ray.__version__}-py3-none-any.whl" in DOCKERFILE
    assert re.search(r"^USER 1000$", DOCKERFILE, re.MULTILINE)
    (layer,) = (part for part in DOCKERFILE.split("\nRUN ") if "cluster.lock" in part.partition("\nCOPY")[0])
    assert "torch.lock" in layer
    assert '--index-url "$TORCH"' in layer
