"""Metrics of the service, and the Grafana dashboard that shows them."""

import json
import re

from repository import ROOT

from thermojoint.live.metrics import fresh_metrics


def test_the_grafana_dashboard_asks_for_metrics_and_labels_that_exist_and_leaves_none_out():
    metrics = fresh_metrics()
    metrics.samples.labels("model").inc()
    metrics.arrivals.labels("late").inc()
    metrics.events.labels("start").inc()
    metrics.quality.labels("good").set(1.0)
    metrics.modes.labels("mill", "follow").inc()
    metrics.next_readings.labels("mill", "asked").inc()
    # Prometheus itself adds the instance.
    labels = {
        sample.name: set(sample.labels) | {"instance"}
        for family in metrics.registry.collect()
        for sample in family.samples
    }
    dashboard = json.loads((ROOT / "deploy" / "grafana.json").read_text("utf-8"))
    asked = set()
    for panel in dashboard["panels"]:
        for target in panel["targets"]:
            expression = target["expr"]
            [name] = re.findall(r"(\w+)\{", expression)
            by = set(re.findall(r"\w+", re.search(r"by \(([^)]*)\)", expression)[1]))
            assert by <= labels[name], panel["title"]
            assert set(re.findall(r"\{\{(\w+)\}\}", target["legendFormat"])) <= by
            asked.add(name)
    shown = {re.sub(r"_(bucket|total|sum|count|created)$", "", name) for name in asked}
    own = {
        family.name
        for family in metrics.registry.collect()
        if family.name.startswith("thermojoint_")
    }
    assert own <= shown


def test_the_panels_of_the_grafana_dashboard_lie_beside_each_other():
    dashboard = json.loads((ROOT / "deploy" / "grafana.json").read_text("utf-8"))
    places = [panel["gridPos"] for panel in dashboard["panels"]]
    taken = [
        (x, y)
        for place in places
        for x in range(place["x"], place["x"] + place["w"])
        for y in range(place["y"], place["y"] + place["h"])
    ]
    assert len(set(taken)) == len(taken)
    assert max(x for x, _ in taken) == 23
    assert len({panel["id"] for panel in dashboard["panels"]}) == len(places)
