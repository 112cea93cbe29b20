"""Holds the manifests against each other and against our programs."""

import argparse
import json
import re
import subprocess
import tempfile
import urllib.request
from pathlib import Path

import jsonschema
import promql_parser
import yaml

HERE = Path(__file__).parent
KUBERNETES = HERE / "kubernetes"
COMPONENT = "app.kubernetes.io/component"


def documents():
    """All objects of the folder, by kind and name."""
    objects = {}
    for path in sorted(KUBERNETES.glob("*.yaml")):
        for document in yaml.safe_load_all(path.read_text()):
            key = document["kind"], document.get("metadata", {}).get("name", path.name)
            assert key not in objects, f"{path}: {key} is there twice"
            objects[key] = document
    return objects


def check_options(program, arguments):
    """The program knows the options: it refuses unknown ones before it gets to its help."""
    result = subprocess.run([program, *arguments, "--help"], capture_output=True, text=True, check=False)
    assert result.returncode == 0, f"{program} {arguments}: {result.stderr}"
    return result.stdout


def check_variables(help_text, names, where):
    """Variables of ours are those that the program reads."""
    known = set(re.findall(r"\[env: (\w+)", help_text)) | {"PHOTONFARM_TOKEN"}
    for name in names:
        assert not name.startswith("PHOTONFARM_") or name in known, f"{where}: {name} is not read by the program"


def secrets(objects):
    """Every reference to a secret, as name and key, with where it is."""
    for (kind, name), document in objects.items():
        text = f"{kind} {name}"
        if kind == "TriggerAuthentication":
            for item in document["spec"]["secretTargetRef"]:
                yield item["name"], item["key"], text
        if kind != "Deployment":
            continue
        pod = document["spec"]["template"]["spec"]
        for variable in pod["containers"][0]["env"]:
            if "valueFrom" in variable:
                reference = variable["valueFrom"]["secretKeyRef"]
                yield reference["name"], reference["key"], text
        for volume in pod["volumes"]:
            if "secret" in volume:
                for item in volume["secret"].get("items", [{"key": None}]):
                    yield volume["secret"]["secretName"], item["key"], text


def check_deployments(objects, programs):
    """Pods match their selectors, mounts their volumes, and options their programs."""
    for name, program in (("coordinator", "photonfarm"), ("worker", "photonfarm-worker")):
        deployment = objects["Deployment", f"photonfarm-{name}"]["spec"]
        labels = deployment["template"]["metadata"]["labels"]
        assert labels[COMPONENT] == name and deployment["selector"]["matchLabels"] == labels, name
        pod = deployment["template"]["spec"]
        container = pod["containers"][0]
        help_text = check_options(programs / program, container["args"])
        check_variables(help_text, [variable["name"] for variable in container["env"]], name)
        assert {m["name"] for m in container["volumeMounts"]} == {v["name"] for v in pod["volumes"]}, name
        assert container["resources"]["requests"] and container["resources"]["limits"]["memory"], name
        budget = objects["PodDisruptionBudget", f"photonfarm-{name}"]["spec"]
        assert budget["selector"]["matchLabels"] == labels, name
    service = objects["Service", "photonfarm-coordinator"]["spec"]
    assert service["selector"][COMPONENT] == "coordinator"
    ports = objects["Deployment", "photonfarm-coordinator"]["spec"]["template"]["spec"]["containers"][0]["ports"]
    assert service["ports"][0]["targetPort"] in {port["name"] for port in ports}


def check_scaling(objects):
    """The scaler's objects fit the schema; its target, its credentials and its metric are there."""
    schema = json.loads((HERE / "keda.schema.json").read_text())
    for (kind, name), document in objects.items():
        if document["apiVersion"].startswith("keda.sh/"):
            errors = list(jsonschema.Draft202012Validator(schema["$defs"][kind] | {"$defs": schema["$defs"]}).iter_errors(document))
            assert not errors, f"{kind} {name}: {jsonschema.exceptions.best_match(errors)}"
    scaled = objects["ScaledObject", "photonfarm-worker"]["spec"]
    assert ("Deployment", scaled["scaleTargetRef"]["name"]) in objects
    trigger = scaled["triggers"][0]
    assert ("TriggerAuthentication", trigger["authenticationRef"]["name"]) in objects
    source = (HERE.parent / "coordinator/src/api/metrics.rs").read_text()
    metric = trigger["metadata"]["valueLocation"].removeprefix("photonfarm_")
    assert f'"{metric}"' in source, f"there is no metric {metric}"


def check_secrets(objects):
    """Every secret that is asked for is described, with its keys."""
    for name, key, where in secrets(objects):
        described = objects["Secret", name]["stringData"]
        assert key is None or key in described, f"{where}: the secret {name} has no key {key}"


def check_compose(programs):
    """Options and variables of the services are those of the programs; secrets are declared."""
    compose = yaml.safe_load((HERE / "compose.yaml").read_text())
    for name, program in (("coordinator", "photonfarm"), ("worker", "photonfarm-worker")):
        service = compose["services"][name]
        help_text = check_options(programs / program, service.get("command", []))
        check_variables(help_text, service["environment"], f"compose service {name}")
        assert set(service["secrets"]) <= set(compose["secrets"]), name
        assert service["build"]["target"] in (HERE / "Containerfile").read_text(), name


def figures(programs):
    """Every metric that a coordinator shows, with the names of its labels."""
    with tempfile.TemporaryDirectory() as folder:
        command = [programs / "photonfarm", "serve", "--listen", "127.0.0.1:0", "--data", folder]
        coordinator = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        try:
            address = coordinator.stdout.readline().split()[-1]
            with urllib.request.urlopen(f"{address}/metrics", timeout=30) as reply:
                text = reply.read().decode()
        finally:
            coordinator.terminate()
            coordinator.wait(timeout=60)
    known = {}
    for name, labels in re.findall(r"^(\w+)(?:\{(.*)\})? \S+$", text, re.MULTILINE):
        known.setdefault(name, set()).update(re.findall(r'(\w+)="', labels))
    return known


def check_board(programs):
    """The board's queries can be parsed, and ask for metrics and labels that there are; every metric is on the board."""
    board = json.loads((HERE / "grafana/photonfarm.json").read_text())
    known, shown = figures(programs), set()
    panels = board["panels"]
    assert len({panel["id"] for panel in panels}) == len(panels), "two panels have one number"
    for panel in panels:
        for target in panel["targets"]:
            query = target["expr"].replace("$__rate_interval", "5m")
            promql_parser.parse(query)
            names = set(re.findall(r"photonfarm_\w+", query))
            assert names and names <= known.keys(), f"{panel['title']}: there is no metric {names - known.keys()}"
            labels = {label for group in re.findall(r"by \(([^)]*)\)", query) for label in re.split(r",\s*", group)}
            labels |= set(re.findall(r"\{\{(\w+)\}\}", target["legendFormat"]))
            for name in names:
                assert labels <= known[name], f"{panel['title']}: {name} has no label {labels - known[name]}"
            shown |= names
    assert shown == known.keys(), f"not on the board: {known.keys() - shown}"
    return len(panels)


def main():
    """Runs all checks."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--programs", type=Path, required=True)
    programs = parser.parse_args().programs
    objects = documents()
    resources = set(objects["Kustomization", "kustomization.yaml"]["resources"])
    assert resources == {path.name for path in KUBERNETES.glob("*.yaml")} - {"kustomization.yaml", "secrets.example.yaml"}
    check_deployments(objects, programs)
    check_scaling(objects)
    check_secrets(objects)
    check_compose(programs)
    panels = check_board(programs)
    print(f"{len(objects)} objects and the Compose file fit together; so do {panels} panels and the metrics")


if __name__ == "__main__":
    main()
