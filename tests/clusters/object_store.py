"""Object store on a node of a test bed: moto's server with one bucket."""

import json

from bed import REPOSITORY, VENV, Bed, Node

BUCKET = "bucket"
PORT = 5000

READ = f"""
import json, sys
sys.path += ["{REPOSITORY}/tests/clusters", "{REPOSITORY}/tests/runs"]
from checkout import tables
print(json.dumps(tables(sys.argv[1])))
"""


class ObjectStore:
    """Mock server of S3 and other services of AWS, by moto."""

    def __init__(self, bed: Bed, name: str) -> None:
        self._node = bed.nodes[name]
        values = dict.fromkeys(("ACCESS_KEY_ID", "SECRET_ACCESS_KEY"), "testing")
        values |= dict.fromkeys(("REGION", "DEFAULT_REGION"), "us-east-1")
        values |= {"ENDPOINT_URL": f"http://{self._node.address}:{PORT}", "EC2_METADATA_DISABLED": "true"}
        self.variables = {f"AWS_{name}": value for name, value in values.items()}

    def make_known(self, node: Node) -> None:
        """Set the environment variables of the store on a node."""
        lines = "".join(f"export {name}={value}\n" for name, value in self.variables.items())
        node.write("/etc/profile.d/store.sh", lines)

    def start(self) -> None:
        """Start the server on its node, and create the bucket."""
        self._node.run(
            f"nohup {VENV}/bin/moto_server -H 0.0.0.0 -p {PORT} > moto.log 2>&1 & "
            f"until (exec 3<>/dev/tcp/127.0.0.1/{PORT}) 2>/dev/null; do sleep 0.5; done; "
            f'{VENV}/bin/python -c \'import boto3; boto3.client("s3").create_bucket(Bucket="{BUCKET}")\''
        )

    def tables(self, root: str) -> dict[str, str]:
        """Return the tables of a root in the bucket; see `checkout.tables`."""
        self._node.write("/tmp/read.py", READ)
        output = self._node.run(f"{VENV}/bin/python /tmp/read.py s3://{BUCKET}/{root}")
        found: dict[str, str] = json.loads(output.splitlines()[-1])
        return found
