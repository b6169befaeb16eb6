"""Container files: pinned images, closed containers, secrets that exist, settings and programs that exist."""

import importlib.util
import os
import re
import shutil
import stat
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from api.web.settings import Settings
from worker.run.settings import WorkerSettings
from worker.store.files.secret_files import S3_KEYS

ROOT = Path(__file__).parents[2]
DOCKER = ROOT / "docker"
COMPOSE = [DOCKER / "compose.yml", DOCKER / "compose.cluster.yml"]
KUBERNETES = ROOT / "deploy" / "kubernetes"
SERVICES = [
    pytest.param(path, name, id=f"{path.stem}-{name}")
    for path in COMPOSE
    for name in yaml.safe_load(path.read_text())["services"]
]
OTHER_VARIABLES = {
    *(f"{name}_FILE" for name in S3_KEYS),
    "AWS_ENDPOINT_URL", "AWS_REGION", "MULTICAP_HOME", "TMPDIR", "WORKER_PROCESSES",
}  # fmt: skip
# Variables of the compose files themselves.
COMPOSE_VARIABLES = {
    "MULTICAP_API", "MULTICAP_SITE", "MULTICAP_TLS", "POSTGRES_USER", "POSTGRES_DB", "POSTGRES_PASSWORD_FILE",
}  # fmt: skip


def settings() -> set[str]:
    names = {f"MULTICAP_{name.upper()}" for name in (*Settings.model_fields, *WorkerSettings.model_fields)}
    return names | {f"{name}_FILE" for name in names}


def documents() -> Iterator[tuple[str, Any]]:
    for path in sorted(KUBERNETES.rglob("*.yaml")):
        for number, document in enumerate(yaml.safe_load_all(path.read_text())):
            yield f"{path.relative_to(KUBERNETES)}[{number}]", document


def pods() -> Iterator[tuple[str, Any]]:
    for place, document in documents():
        if document["kind"] in {"Deployment", "StatefulSet", "Job"}:
            yield place, document["spec"]["template"]["spec"]


@pytest.mark.parametrize(("path", "name"), SERVICES)
def test_containers_are_closed_and_limited(path: Path, name: str) -> None:
    service = yaml.safe_load(path.read_text())["services"][name]
    assert service["read_only"] is True
    assert service["cap_drop"] == ["ALL"]
    assert service["security_opt"] == ["no-new-privileges:true"]
    assert {"mem_limit", "pids_limit", "restart", "healthcheck"} <= service.keys()
    assert re.fullmatch(r"[a-z/]+:(\d[\w.]*(-[a-z]+)?|\$\{MULTICAP_VERSION:-local\})", service["image"])
    for capability in service.get("cap_add", []):
        assert (name, capability) in {("proxy", "NET_BIND_SERVICE"), ("s3", "DAC_OVERRIDE")}
    if path.stem == "compose.cluster":
        assert "cpus" in service
        assert not [network for network in service["networks"] if network not in {"front", "back"}]
        assert ("ports" in service) == (name == "proxy")


@pytest.mark.parametrize("path", COMPOSE, ids=lambda path: path.stem)
def test_large_arrays_of_workers_are_on_a_volume(path: Path) -> None:
    worker = yaml.safe_load(path.read_text())["services"]["worker"]
    assert worker["environment"]["TMPDIR"] in worker["volumes"]
    assert worker["environment"].keys() > {"TMPDIR"}


@pytest.mark.parametrize("path", COMPOSE, ids=lambda path: path.stem)
def test_one_image_is_built_once(path: Path) -> None:
    services = yaml.safe_load(path.read_text())["services"]
    assert len([name for name, service in services.items() if "build" in service]) == 1


def test_verification_has_bases_of_all_files() -> None:
    """Images that the script pulls or makes stand-ins for are those of the Dockerfile and the compose files."""
    stages = re.findall(r"^FROM (\S+)(?: AS (\S+))?", (DOCKER / "multicap.Dockerfile").read_text(), re.MULTILINE)
    built = {base for base, _ in stages} - {name for _, name in stages}
    services = [service for path in COMPOSE for service in yaml.safe_load(path.read_text())["services"].values()]
    named = {service["image"] for service in services if not service["image"].startswith("multicap:")}
    script = (DOCKER / "verify" / "containers.sh").read_text()
    (bases,) = re.findall(r"^BASES=\(([^)]*)\)", script, re.MULTILINE)
    assert sorted(bases.split()) == sorted(built | named)
    # The stand-in of the S3 server has the image's version.
    standins = (DOCKER / "verify" / "standins.sh").read_text()
    (version,) = re.findall(r"^STANDIN_WEED=\S+==(\S+)$", standins, re.MULTILINE)
    assert f"chrislusf/seaweedfs:{version}" in named


def test_api_processes_share_uploads_as_proxy_takes_turns() -> None:
    services = yaml.safe_load((DOCKER / "compose.cluster.yml").read_text())["services"]
    names = [name for name in services if name.startswith("api-")]
    assert len(names) >= 2
    assert {services[name]["environment"]["MULTICAP_SHARED_UPLOADS"] for name in names} == {"true"}
    proxy = (DOCKER / "Caddyfile").read_text()
    assert re.findall(r"lb_policy (.*)", proxy) == ["round_robin"]
    assert re.findall(r"reverse_proxy \{\$MULTICAP_API:(.*)\} \{", proxy) == [
        " ".join(f"{name}:8000" for name in names)
    ]
    by_kind = {document["kind"]: document for _, document in documents()}
    assert by_kind["ConfigMap"]["data"]["MULTICAP_SHARED_UPLOADS"] == "true"
    assert not [name for name in by_kind["Ingress"]["metadata"]["annotations"] if "hash" in name or "affinity" in name]


@pytest.mark.parametrize("page", sorted((ROOT / "docs" / "operate").glob("*.md")), ids=lambda page: page.stem)
def test_pages_name_variables_that_exist(page: Path) -> None:
    compose = set(re.findall(r"\$\{(MULTICAP_\w+):-", (DOCKER / "compose.cluster.yml").read_text()))
    named = set(re.findall(r"\bMULTICAP_[A-Z_]+", page.read_text("utf-8")))
    assert named <= settings() | OTHER_VARIABLES | COMPOSE_VARIABLES | compose


@pytest.mark.parametrize(("path", "name"), SERVICES)
def test_variables_are_settings_and_programs_exist(path: Path, name: str) -> None:
    service = yaml.safe_load(path.read_text())["services"][name]
    assert set(service.get("environment", {})) <= settings() | OTHER_VARIABLES | COMPOSE_VARIABLES
    text = str(service.get("command", ""))
    for module in re.findall(r"multicap\.(\w+(?:\.\w+)*)", text):
        assert importlib.util.find_spec(module) is not None


def test_secrets_are_made_once_and_kept(tmp_path: Path) -> None:
    folder = tmp_path / "secrets"
    command = ["sh", str(DOCKER / "make_secrets.sh"), str(folder)]
    subprocess.run(command, check=True)
    compose = yaml.safe_load((DOCKER / "compose.cluster.yml").read_text())
    files = {Path(secret["file"]).name for secret in compose["secrets"].values()}
    contents = {path.name: path.read_text() for path in folder.iterdir()}
    assert set(contents) == files
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert len({contents[name] for name in ("database_password", "redis_password", "s3_key_id", "s3_secret_key")}) == 4
    assert contents["database_password"] in contents["database_url"]
    assert contents["redis_password"] in contents["broker_url"]
    assert f"requirepass {contents['redis_password']}\n" in contents["redis.conf"]
    (identity,) = yaml.safe_load(contents["s3.json"])["identities"]
    assert identity["credentials"] == [{"accessKey": contents["s3_key_id"], "secretKey": contents["s3_secret_key"]}]
    (folder / "redis_password").unlink()
    (folder / "redis_password").write_text("mine")
    subprocess.run(command, check=True)
    assert (folder / "redis_password").read_text() == "mine"
    assert {name: text for name, text in contents.items() if name != "redis_password"} == {
        path.name: path.read_text() for path in folder.iterdir() if path.name != "redis_password"
    }


def test_every_secret_is_used_and_none_is_in_files() -> None:
    compose = yaml.safe_load((DOCKER / "compose.cluster.yml").read_text())
    used = {secret for service in compose["services"].values() for secret in service.get("secrets", [])}
    assert used == set(compose["secrets"])
    ignored = (ROOT / ".gitignore").read_text().splitlines()
    assert "/docker/secrets/" in ignored


@pytest.mark.parametrize("place", [place for place, _ in pods()])
def test_pods_are_closed_and_limited(place: str) -> None:
    pod = dict(pods())[place]
    assert pod["automountServiceAccountToken"] is False
    assert pod["securityContext"]["runAsNonRoot"] is True
    assert pod["securityContext"]["seccompProfile"] == {"type": "RuntimeDefault"}
    for container in (*pod["containers"], *pod.get("initContainers", [])):
        assert container["image"] == "multicap"
        assert container["securityContext"] == {
            "readOnlyRootFilesystem": True,
            "allowPrivilegeEscalation": False,
            "capabilities": {"drop": ["ALL"]},
        }
        assert {"memory", "cpu"} == set(container["resources"]["limits"])
        mounted = {mount["name"] for mount in container["volumeMounts"]}
        assert mounted <= {"data"} | {volume["name"] for volume in pod["volumes"]}
        for module in re.findall(r"multicap\.(\w+(?:\.\w+)*)", str(container["command"])):
            assert importlib.util.find_spec(module) is not None


def test_objects_of_kubernetes_name_each_other() -> None:
    by_kind: dict[str, dict[str, Any]] = {}
    for _, document in documents():
        by_kind.setdefault(document["kind"], {})[document.get("metadata", {}).get("name", "")] = document
    (base,) = [document for place, document in documents() if place.startswith("base/kustomization")]
    assert {f"base/{name}" for name in base["resources"]} | {"base/kustomization.yaml"} == {
        path.relative_to(KUBERNETES).as_posix() for path in (KUBERNETES / "base").iterdir()
    }
    assert set(by_kind["ConfigMap"]["multicap"]["data"]) <= settings() | OTHER_VARIABLES
    assert by_kind["ScaledObject"]["worker"]["spec"]["scaleTargetRef"]["name"] in by_kind["Deployment"]
    assert by_kind["StatefulSet"]["api"]["spec"]["serviceName"] in by_kind["Service"]
    (path,) = by_kind["Ingress"]["multicap"]["spec"]["rules"][0]["http"]["paths"]
    assert path["backend"]["service"]["name"] in by_kind["Service"]
    # Workers of a pod, and the chunks at which another pod is started.
    command = by_kind["Deployment"]["worker"]["spec"]["template"]["spec"]["containers"][0]["command"]
    assert by_kind["ScaledObject"]["worker"]["spec"]["triggers"][0]["metadata"]["threshold"] == command[-1]


@pytest.mark.skipif(shutil.which("caddy") is None, reason="Caddy is not installed")
@pytest.mark.parametrize("path", COMPOSE, ids=lambda path: path.stem)
def test_proxy_accepts_its_file(path: Path) -> None:
    # The values of the compose file, without those that Compose itself fills in.
    given = yaml.safe_load(path.read_text())["services"]["proxy"]["environment"]
    subprocess.run(
        ["caddy", "validate", "--config", str(DOCKER / "Caddyfile"), "--adapter", "caddyfile"],
        check=True,
        capture_output=True,
        env=os.environ | {name: value for name, value in given.items() if "$" not in value},
    )
