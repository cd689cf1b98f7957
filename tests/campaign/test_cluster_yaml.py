"""Files for Ray's cluster launcher and KubeRay, held against Ray's own code and KubeRay's reference."""

import copy
import re
from pathlib import Path
from typing import Any

import jsonschema
import pytest
import yaml
from kuberay_schema import JOB, KUBERAY
from ray.autoscaler._private.util import prepare_config, validate_config
from suite.locked import locked

import tma_ray
from tma_ray import cli
from tma_ray.campaign import Campaign, cells_of
from tma_ray.campaign.executors.cohorts import learner_resources, room_of, stack_keys
from tma_ray.campaign.settings import GIB, ExecutionConfig, Resources
from tma_ray.console.command_line import read
from tma_ray.envs import ENVIRONMENTS

FILE = Path(__file__).parents[2] / "cluster.yaml"
CONFIG: dict[str, Any] = yaml.safe_load(FILE.read_text())
TYPES: dict[str, dict[str, Any]] = CONFIG["available_node_types"]
WORKERS = {name: each for name, each in TYPES.items() if name != CONFIG["head_node_type"]}
STARTS = {kind: " ".join(CONFIG[f"{kind}_start_ray_commands"]) for kind in ("head", "worker")}
LOCAL: dict[str, Any] = yaml.safe_load((FILE.parent / "cluster-local.yaml").read_text())


def test_ray_finds_the_file_valid_and_would_find_a_slip() -> None:
    validate_config(prepare_config(copy.deepcopy(CONFIG)))
    too_few = {**copy.deepcopy(CONFIG), "max_workers": 1}
    too_few["available_node_types"]["cpu_worker"]["min_workers"] = 2
    with pytest.raises(ValueError, match="max_workers"):
        validate_config(prepare_config(too_few))


def test_nodes_hold_runs_and_the_head_holds_none() -> None:
    default = Resources()
    fit = {name: default.fit_into(each["resources"]) for name, each in TYPES.items()}
    assert fit == {"head": 0, "cpu_worker": 16, "gpu_worker": 16}
    assert Resources(gpus=0.125).fit_into(TYPES["gpu_worker"]["resources"]) == 8
    assert Resources(gpus=0.125).fit_into(TYPES["cpu_worker"]["resources"]) == 0
    assert "--num-cpus=0" in STARTS["head"]


def test_a_gpu_node_holds_a_full_cohort_of_sac() -> None:
    settings = ExecutionConfig(device="cuda")
    runs = Campaign("full", cells_of(("random",)), (0,)).plan().runs
    learner = learner_resources(settings, runs, stack_keys(runs))
    rooms = {name: room_of(each["resources"], settings, learner) for name, each in TYPES.items()}
    assert rooms == {"head": (0, 0), "cpu_worker": (0, 0), "gpu_worker": (1, settings.width)}


def test_workers_are_spot_nodes_within_bounds_and_the_head_stays() -> None:
    options = {name: each["node_config"].get("InstanceMarketOptions", {}) for name, each in TYPES.items()}
    markets = {name: each.get("MarketType") for name, each in options.items()}
    assert markets == {"head": None, "cpu_worker": "spot", "gpu_worker": "spot"}
    assert sum(each["max_workers"] for each in WORKERS.values()) == CONFIG["max_workers"]
    assert all(0 <= each["min_workers"] <= each["max_workers"] for each in WORKERS.values())


def test_no_port_is_open_and_every_node_asks_for_the_token() -> None:
    assert "--dashboard-host=127.0.0.1" in STARTS["head"]
    for start in STARTS.values():
        assert "export RAY_AUTH_MODE=token" in start.partition("ray start")[0]
    text = FILE.read_text()
    assert "0.0.0.0" not in text
    assert "::/0" not in text
    for each in TYPES.values():  # without one, the launcher makes a group whose port 22 all the world may try
        assert each["node_config"]["SecurityGroupIds"]
    assert "security_group" not in CONFIG["provider"]


def test_the_file_holds_no_secret_and_the_token_comes_from_the_user() -> None:
    assert CONFIG["file_mounts"]["~/.ray/auth_token"] == "~/.ray/auth_token"
    text = FILE.read_text()
    assert not re.search("AKIA|aws_secret|aws_access|RAY_AUTH_TOKEN=|PRIVATE KEY|password", text, re.I)
    assert not re.search(r"\b[0-9a-f]{32,}\b", text)


@pytest.mark.parametrize("config", [CONFIG, LOCAL], ids=["aws", "local"])
def test_exactly_this_version_is_installed_from_mounted_files(config: dict[str, Any]) -> None:
    wheel = f"tma_ray-{tma_ray.__version__}-py3-none-any.whl"
    mounts = config["file_mounts"]
    assert mounts[f"~/tma_ray/{wheel}"] == f"dist/{wheel}"
    locks = {"cluster.lock", "torch.lock"}
    assert {mounts[f"~/tma_ray/{name}"] for name in locks} == locks
    kinds = ("setup_commands", "head_setup_commands")
    commands = [command for kind in kinds for command in config.get(kind, ())]
    installs = [found[1] for each in commands if (found := re.search(r"pip install --quiet (.*)", each))]
    assert installs == [
        "--no-deps --requirement ~/tma_ray/cluster.lock",
        f"--no-deps --force-reinstall ~/tma_ray/{wheel}",
        "$build --requirement ~/tma_ray/torch.lock",
        *(["boto3==" + locked()["boto3"]] if config is CONFIG else []),
    ]


def test_nodes_have_the_versions_that_the_project_is_tested_with() -> None:
    nodes, torch, tested = (locked(name) for name in ("cluster.lock", "torch.lock", "requirements.lock"))
    assert {"ray", "numba", "pyarrow", "stable-baselines3"} <= nodes.keys()
    assert torch.keys() == {"torch"}
    assert not nodes.keys() & torch.keys()
    assert (nodes | torch).items() <= tested.items()


def test_four_lines_of_the_local_file_are_to_be_filled_in() -> None:
    text = (FILE.parent / "cluster-local.yaml").read_text()
    assert len(re.findall(r"# yours", text)) == 4
    validate_config(prepare_config(copy.deepcopy(LOCAL)))
    starts = " ".join(LOCAL["head_start_ray_commands"] + LOCAL["worker_start_ray_commands"])
    assert starts.count("export RAY_AUTH_MODE=token") == 2
    assert "--dashboard-host=127.0.0.1" in starts


@pytest.mark.parametrize("commands", [CONFIG["setup_commands"], LOCAL["setup_commands"]])
def test_every_environment_is_compiled_on_every_node(commands: list[str]) -> None:
    (warm,) = (command for command in commands if "tma-ray run" in command)
    loop, _, rest = warm.partition("; do ")
    assert set(loop.split(" in ")[1].split()) == set(ENVIRONMENTS.names())
    arguments = rest.removesuffix("; done").replace("$(mktemp -d)", "FOLDER").split()[1:]
    options = read(cli.app(), arguments).keywords["options"]
    assert (options.steps, options.evaluation_interval) == (1000, 1000)
    assert warm == commands[-1], "what it needs is installed before"


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
    assert CLUSTER["rayVersion"] == locked("cluster.lock")["ray"]


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
    assert (DEPLOY.parent / "experiments" / f"{found[1]}.py").is_file()
    call = read(cli.app(), [found[1], *found[2].split()])
    options = call.keywords["options"]
    assert (options.address, options.autoscaling, options.yes) == ("auto", True, True)
    assert options.results.startswith("/results/")
    assert MANIFEST["spec"]["backoffLimit"] > 0
    assert "sleep 120" in MANIFEST["spec"]["entrypoint"], "a killed campaign's root is held so long"


def test_the_image_has_this_version_one_layer_of_locked_packages_and_no_root() -> None:
    assert f"tma_ray-{tma_ray.__version__}-py3-none-any.whl" in DOCKERFILE
    assert re.search(r"^USER 1000$", DOCKERFILE, re.MULTILINE)
    (layer,) = (part for part in DOCKERFILE.split("\nRUN ") if "cluster.lock" in part.partition("\nCOPY")[0])
    assert "torch.lock" in layer
    assert '--index-url "$TORCH"' in layer
