"""`cluster.yaml` at a server that answers as AWS (moto), whose instances are machines of a bed."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from bed import REPOSITORY, VENV, Bed, bed_of, wait_until
from checkout import CAMPAIGN, lend_environment, tables
from instances import Instances
from launcher import Laptop
from object_store import BUCKET, ObjectStore

SHORT = CAMPAIGN.replace("--steps 20000", "--steps 8000")

ACCOUNT = """
import boto3

iam, ec2 = boto3.client("iam"), boto3.client("ec2")
for name in ("tma-ray-head", "tma-ray-worker"):
    iam.create_instance_profile(InstanceProfileName=name)
group = ec2.create_security_group(GroupName="tma-ray", Description="tma_ray")["GroupId"]
ec2.authorize_security_group_ingress(
    GroupId=group, IpPermissions=[{"IpProtocol": "-1", "UserIdGroupPairs": [{"GroupId": group}]}]
)
print(group, ec2.describe_images()["Images"][0]["ImageId"])
"""
"""What steps 3 to 5 of docs/clusters.md make, and the two values for cluster.yaml."""


@pytest.fixture(scope="module")
def bed() -> Iterator[Bed]:
    with bed_of("laptop") as bed:
        yield bed


def test_the_head_starts_a_spot_worker_for_waiting_runs_and_down_ends_both(bed: Bed, wheel: Path) -> None:
    (node,) = bed.on("laptop")
    store = ObjectStore(bed, "laptop")
    lend_environment(node)
    store.make_known(node)
    laptop = Laptop(node, wheel)
    store.start()
    node.write("/tmp/account.py", ACCOUNT)
    group, image = node.run(f"{VENV}/bin/python /tmp/account.py").split()
    text = (REPOSITORY / "cluster.yaml").read_text()
    laptop.write(
        "cluster.yaml", text.replace("ami-00000000000000000", image).replace("sg-00000000000000000", group)
    )

    instances = Instances(bed, node, store)
    laptop.run("ray up --yes cluster.yaml")
    (head,) = instances.of_kind("head")
    assert head["InstanceType"] == "m7i.large"
    assert head["IamInstanceProfile"]["Arn"].endswith("/tma-ray-head")
    assert not instances.of_kind("worker")

    results = f"s3://{BUCKET}/results"
    flags = f"--address auto --autoscaling --yes --results {results}"
    output = laptop.run(f"ray submit cluster.yaml {SHORT} {flags}")
    assert "4/4 runs done" in output
    assert re.search("to which the cluster may grow", output.replace("\r\n", ""))
    (worker,) = instances.of_kind("worker")
    assert worker["InstanceType"] == "c7i.4xlarge"
    assert worker["IamInstanceProfile"]["Arn"].endswith("/tma-ray-worker")
    laptop.run(f"python {SHORT} --local --results /shared/undisturbed")
    assert store.tables("results") == tables(bed.shared / "undisturbed")

    laptop.run("ray down --yes cluster.yaml")
    wait_until(lambda: {each["State"]["Name"] for each in instances.seen.values()} == {"terminated"}, 60)
    instances.close()
