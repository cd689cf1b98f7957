"""Virtual machines for the instances that a launcher starts on a mock server of AWS."""

import json
import threading
from typing import Any

from bed import USER, VENV, Bed, Node
from checkout import lend_environment
from object_store import ObjectStore

WATCH = """
import json, time
import boto3

while True:
    found = []
    for reservation in boto3.client("ec2").describe_instances()["Reservations"]:
        found += reservation["Instances"]
    print(json.dumps(found, default=str), flush=True)
    time.sleep(2)
"""


class Instances:
    """Watcher that starts a node for every new instance, and stops the nodes of terminated ones."""

    def __init__(self, bed: Bed, laptop: Node, store: ObjectStore) -> None:
        self._bed, self._laptop, self._store = bed, laptop, store
        self.seen: dict[str, dict[str, Any]] = {}  # latest description of each instance by id
        self._nodes: dict[str, Node] = {}
        laptop.write("/tmp/watch.py", WATCH)
        self._process = laptop.start_process(f"{VENV}/bin/python /tmp/watch.py 2> watch.log")
        self._thread = threading.Thread(target=self._watch, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop watching; nodes keep running."""
        self._process.kill()
        self._process.wait()

    def of_kind(self, kind: str) -> list[dict[str, Any]]:
        """Return the instances with the launcher's tag "head" or "worker"."""
        return [each for each in self.seen.values() if tags(each).get("ray-node-type") == kind]

    def _watch(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            for instance in json.loads(line):
                name, state = instance["InstanceId"], instance["State"]["Name"]
                self.seen[name] = instance
                if state == "running" and name not in self._nodes:
                    self._nodes[name] = self._start(instance)
                elif state in ("terminated", "shutting-down") and name in self._nodes:
                    self._nodes.pop(name).power_off()

    def _start(self, instance: dict[str, Any]) -> Node:
        described = (instance[key] for key in ("InstanceId", "PrivateIpAddress", "PublicIpAddress"))
        node = self._bed.add(*described)
        lend_environment(node)
        self._store.make_known(node)
        # There is no network, and all packages are installed already.
        node.write("/usr/local/bin/apt-get", "#!/bin/sh\n")
        node.run("chmod 755 /usr/local/bin/apt-get", user="root")
        public = self._laptop.run("for key in ~/.ssh/*.pem; do ssh-keygen -y -f $key; done")
        node.run(f"echo '{public.strip()}' >> ~{USER}/.ssh/authorized_keys", user="root")
        return node


def tags(instance: dict[str, Any]) -> dict[str, str]:
    """Return the tags of an instance."""
    return {tag["Key"]: tag["Value"] for tag in instance.get("Tags", ())}
