"""The image for Kubernetes, built by its recipe with buildah, and a campaign in a container of it."""

import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from bed import REPOSITORY
from checkout import copy_checkout, locked_packages

IMAGE = "localhost/tma_ray:tested"
BASE = "localhost/debian:tested"
LACKING = [each for each in ("buildah", "debootstrap") if shutil.which(each) is None]
pytestmark = pytest.mark.skipif(bool(LACKING), reason=f"needs {' and '.join(LACKING)}")


def buildah(*arguments: object) -> str:
    """Return the output of a command of buildah."""
    output = subprocess.run(["buildah", *map(str, arguments)], check=True, stdout=subprocess.PIPE, text=True)
    sys.stdout.write(output.stdout)
    return output.stdout.strip()


@pytest.fixture(scope="module")
def image(tmp_path_factory: pytest.TempPathFactory, wheel: Path) -> Iterator[str]:
    """The CPU image, from a minimal Debian 12 that needs no registry of images, and packages of a folder."""
    folder, wheels = tmp_path_factory.mktemp("image"), locked_packages("3.11")
    subprocess.run(["debootstrap", "--variant=minbase", "bookworm", folder / "base"], check=True)
    base = buildah("from", "scratch")
    buildah("add", "--quiet", base, folder / "base", "/")
    buildah("commit", "--rm", "--quiet", base, BASE)
    copy_checkout(folder / "checkout", wheel)
    (folder / "pip.conf").write_text(f"[global]\nno-index = true\nfind-links = {wheels}\n")
    mounts = (f"--volume={folder}/pip.conf:/etc/pip.conf:ro", f"--volume={wheels}:{wheels}:ro")
    recipe = REPOSITORY / "deploy" / "Dockerfile"
    buildah("build", "--isolation=chroot", *mounts, f"--build-arg=BASE={BASE}", f"--file={recipe}",
            f"--tag={IMAGE}", folder / "checkout")  # fmt: skip
    yield IMAGE
    buildah("rmi", IMAGE, BASE)


def test_the_image_trains_without_root_and_without_cuda(image: str) -> None:
    container = buildah("from", "--pull-never", image)
    flags = "--teachers random --seeds 1 --steps 2000 --evaluation-interval 2000 --memory-per-run 0.5 --yes"
    command = f"id -u; pip freeze; python experiments/quickstart.py {flags} --results /results/small"
    try:
        output = buildah("run", "--isolation=chroot", container, "--", "sh", "-c", command)
    finally:
        buildah("rm", container)
    assert output.startswith("1000\n")
    assert "+cpu" in output
    assert "nvidia" not in output
    assert "1/1 runs done" in output
