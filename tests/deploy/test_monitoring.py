"""Monitoring files: metrics that exist, alerts that promtool accepts and tests, a dashboard with data."""

import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest
import yaml

from api.web.metrics import RequestMetrics
from worker.store.files.disk import DiskSpace
from worker.store.store import JobStore

MONITORING = Path(__file__).parents[2] / "deploy" / "monitoring"
AUTOSCALING = MONITORING.parent / "kubernetes" / "autoscaling" / "workers.yaml"
PAGE = MONITORING.parents[1] / "docs" / "operate" / "monitoring.md"


@pytest.fixture(scope="module")
def exposed(tmp_path_factory: pytest.TempPathFactory) -> set[str]:
    """Names of all time series."""
    folder = tmp_path_factory.mktemp("metrics")
    store = JobStore(f"sqlite:///{folder / 'multicap.db'}")
    store.migrate()
    metrics = RequestMetrics()
    metrics.count("GET", "/healthz", 200, 0.1)
    text = metrics.expose(store, DiskSpace(folder)).decode()
    store.close()
    families = set(re.findall(r"^# TYPE (\w+)", text, re.MULTILINE))
    return families | set(re.findall(r"^(\w+)[{ ]", text, re.MULTILINE))


@pytest.mark.parametrize("path", [MONITORING / "alerts.yml", MONITORING / "dashboard.json", AUTOSCALING, PAGE], ids=str)
def test_metrics_exist(exposed: set[str], path: Path) -> None:
    names = set(re.findall(r"\bmulticap_\w+", path.read_text()))
    assert names
    assert names <= exposed


def test_every_alert_has_test_and_action() -> None:
    (group,) = yaml.safe_load((MONITORING / "alerts.yml").read_text())["groups"]
    tested = {
        case["alertname"]
        for test in yaml.safe_load((MONITORING / "alerts_test.yml").read_text())["tests"]
        for case in test["alert_rule_test"]
    }
    assert {rule["alert"] for rule in group["rules"]} == tested
    assert all(rule["annotations"].keys() == {"summary", "action"} for rule in group["rules"])


def test_page_has_row_for_each_alert() -> None:
    (group,) = yaml.safe_load((MONITORING / "alerts.yml").read_text())["groups"]
    rows = re.findall(r"^\| `(Multicap\w+)` \| [^|]+ \| [^|]+ \|$", PAGE.read_text("utf-8"), re.MULTILINE)
    assert rows == [rule["alert"] for rule in group["rules"]]


def test_panels_lie_side_by_side() -> None:
    panels = json.loads((MONITORING / "dashboard.json").read_text())["panels"]
    assert len({panel["id"] for panel in panels}) == len(panels) >= 10
    assert len({(panel["gridPos"]["x"], panel["gridPos"]["y"]) for panel in panels}) == len(panels)
    assert all(target["expr"] for panel in panels for target in panel["targets"])


@pytest.mark.skipif(shutil.which("promtool") is None, reason="Prometheus is not installed")
@pytest.mark.parametrize(
    "arguments", [["check", "rules", "alerts.yml"], ["test", "rules", "alerts_test.yml"]], ids=lambda words: words[0]
)
def test_promtool_accepts_alerts(arguments: list[str]) -> None:
    subprocess.run(["promtool", *arguments], cwd=MONITORING, check=True, capture_output=True)


@pytest.mark.skipif(shutil.which("promtool") is None, reason="Prometheus is not installed")
def test_promtool_accepts_scrapes(tmp_path: Path) -> None:
    for path in MONITORING.iterdir():
        shutil.copy(path, tmp_path)
    (tmp_path / "metrics_key").touch()
    subprocess.run(["promtool", "check", "config", "prometheus.yml"], cwd=tmp_path, check=True, capture_output=True)
