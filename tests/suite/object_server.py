"""Local S3 server in a separate process that can be frozen."""

import os
import subprocess
import sys
import urllib.request
from contextlib import AbstractContextManager
from types import TracebackType
from typing import Any, Self
from unittest import mock

NOWHERE = "/nonexistent/aws"
"""Path in place of the user's settings."""

SERVER = """
import sys
from moto.server import ThreadedMotoServer

server = ThreadedMotoServer("127.0.0.1", port=0, verbose=False)
server.start()
print("http://{}:{}".format(*server.get_host_and_port()), flush=True)
sys.stdin.read()
"""


class ObjectServer:
    """Context manager of an S3 server with one empty bucket."""

    bucket = "bucket"
    environment: dict[str, str]
    process: subprocess.Popen[str]

    def __enter__(self) -> Self:
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
        self.process = subprocess.Popen([sys.executable, "-c", SERVER], text=True, **pipes)
        assert self.process.stdout is not None
        url = self.process.stdout.readline().strip()
        assert url, "the S3 server did not start"
        urllib.request.urlopen(urllib.request.Request(f"{url}/{self.bucket}", method="PUT"))
        keys = {"ACCESS_KEY_ID": "testing", "SECRET_ACCESS_KEY": "a-secret/of-the/tests"}
        place = {"REGION": "us-east-1", "ENDPOINT_URL": url, "EC2_METADATA_DISABLED": "true"}
        files = dict.fromkeys(("CONFIG_FILE", "SHARED_CREDENTIALS_FILE"), NOWHERE)
        self.environment = {f"AWS_{name}": value for name, value in (keys | place | files).items()}
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.process.kill()
        self.process.wait()

    def in_environment(self) -> AbstractContextManager[Any]:
        """Context manager that sets the environment variables of the server in this process."""
        return mock.patch.dict(os.environ, self.environment)
