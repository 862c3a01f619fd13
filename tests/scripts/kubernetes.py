#!/usr/bin/env python3
"""Renders docker/kubernetes and validates what comes out against the schemas of several versions of Kubernetes.

    tests/scripts/kubernetes.py

Needs `kustomize`, or a `kubectl`, which has it built in. The schemas come with PyPI's kubernetes-validate, which is installed in
target/kubernetes-venv. No cluster is asked.
"""

import argparse
import re
import shutil
import subprocess
import sys
import tempfile
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "docker" / "kubernetes"
VENV = ROOT / "target" / "kubernetes-venv"
PACKAGES = ["kubernetes-validate==1.35.0", "PyYAML"]
VERSIONS = ["1.28", "1.31", "1.34"]
KINDS = {"Namespace", "ConfigMap", "Service", "StatefulSet", "NetworkPolicy"}


def renderer():
    """The command that renders a kustomization."""
    if shutil.which("kustomize"):
        return ["kustomize", "build"]
    if shutil.which("kubectl"):
        return ["kubectl", "kustomize"]
    sys.exit("kubernetes.py: neither kustomize nor kubectl is installed, expected one of them")


def install():
    """Installs the schemas, and runs this script again with them."""
    if not (VENV / "bin" / "kubernetes-validate").exists():
        venv.create(VENV, with_pip=True)
        subprocess.run([VENV / "bin" / "pip", "--quiet", "install", *PACKAGES], check=True)
    sys.exit(subprocess.run([VENV / "bin" / "python", __file__]).returncode)


def pod_of(objects):
    """The pod that the stateful set makes, and its container."""
    pod = objects["StatefulSet"]["spec"]["template"]["spec"]
    return pod, pod["containers"][0]


def check(name, objects):
    """Checks what no schema says: that the parts fit each other. Returns what is wrong."""
    wrong = [f"no {kind}" for kind in KINDS - objects.keys()]
    if wrong:
        return wrong
    pod, container = pod_of(objects)
    mounted = {mount["name"] for mount in container["volumeMounts"]}
    claims = {claim["metadata"]["name"] for claim in objects["StatefulSet"]["spec"]["volumeClaimTemplates"]}
    volumes = {volume["name"] for volume in pod["volumes"]} | claims
    if mounted != volumes:
        wrong.append(f"volumes {sorted(volumes)}, expected those that are mounted, {sorted(mounted)}")
    ports = {port["name"]: port["containerPort"] for port in container["ports"]}
    for probe in ("startupProbe", "readinessProbe", "livenessProbe"):
        if container[probe]["httpGet"]["port"] not in ports:
            wrong.append(f"{probe} asks for a port that the container does not name")
    config = objects["ConfigMap"]
    used = next(volume["configMap"]["name"] for volume in pod["volumes"] if "configMap" in volume)
    if used != config["metadata"]["name"]:
        wrong.append(f"the pod has the configuration {used}, expected {config['metadata']['name']}")
    text = config["data"]["isopeel.toml"]
    wrong += [f"isopeel.toml does not listen on port {port}" for port in ports.values() if f"0.0.0.0:{port}" not in text]
    drain = int(text.split("drain = ")[1].split()[0])
    if pod["terminationGracePeriodSeconds"] <= drain:
        wrong.append(f"the grace period is {pod['terminationGracePeriodSeconds']} s, expected more than drain, {drain} s")
    has_gpu = "nvidia.com/gpu" in container["resources"]["limits"]
    if has_gpu != (name in {"gpu", "example"}) or container["image"].endswith("-gpu") != has_gpu:
        wrong.append(f"image {container['image']}, GPU {has_gpu}")
    mounts = [mount["mountPath"] for mount in container["volumeMounts"]]
    paths = re.findall(r'^(?:token-file|token-folder|session-key-file) = "(.*)"', text, re.MULTILINE)
    wrong += [f"isopeel.toml names {path}, which no mount has" for path in paths if not any(path.startswith(mount) for mount in mounts)]
    return wrong


def check_many(objects):
    """Checks the parts of several servers: what is hashed, and where jobs are. Returns what is wrong."""
    named = {(item["kind"], item["metadata"]["name"]): item for item in objects}
    wrong = []
    if named["StatefulSet", "isopeel"]["spec"]["replicas"] < 2:
        wrong.append("many has one replica, expected several")
    hashed = named["Ingress", "isopeel"]["metadata"]["annotations"]["nginx.ingress.kubernetes.io/upstream-hash-by"]
    variables = re.findall(r"^map \S+ (\$\w+) ", (ROOT / "docker" / "nginx" / "choose.conf").read_text(), re.MULTILINE)
    if hashed not in variables:
        wrong.append(f"the ingress hashes {hashed}, expected a variable of docker/nginx/choose.conf: {', '.join(variables)}")
    pod = named["Service", "isopeel-jobs"]["spec"]["selector"]["statefulset.kubernetes.io/pod-name"]
    config = next(item for item in objects if item["kind"] == "ConfigMap")["data"]["isopeel.toml"]
    if f'job-server = "{pod}"' not in config:
        wrong.append(f"isopeel-jobs is pod {pod}, which isopeel.toml does not name")
    base = [line for line in (FOLDER / "base" / "isopeel.toml").read_text().splitlines() if line and not line.startswith("#")]
    wrong += [f"isopeel.toml of many lacks {line}" for line in base if line not in config]
    for (kind, name), item in named.items():
        if kind == "Ingress":
            path = item["spec"]["rules"][0]["http"]["paths"][0]
            if ("Service", path["backend"]["service"]["name"]) not in named:
                wrong.append(f"the ingress {name} leads to no service")
    return wrong


def check_readme():
    """Runs the lines of docker/README.md that make objects, as far as kubectl does without a cluster. Returns what is wrong."""
    if not shutil.which("kubectl"):
        print("the lines of docker/README.md: not run, kubectl is not installed")
        return []
    lines = (ROOT / "docker" / "README.md").read_text().splitlines()
    lines = [line.strip() for line in lines if line.startswith("    kubectl") and " create " in line and " exec " not in line]
    # The folder of the lines is that of the repository.
    lines = [line.split(" --dry-run")[0].replace("=docker/", f"={ROOT}/docker/") for line in lines]
    wrong = [] if len(lines) == 5 else [f"docker/README.md has {len(lines)} lines that create objects, expected a namespace, three secrets and a map"]
    with tempfile.TemporaryDirectory() as folder:
        for name in ("token", "key", "tokens.json"):
            (Path(folder) / name).write_text("a token")
        for line in lines:
            made = subprocess.run([*line.split(), "--dry-run=client", "--output=yaml"], cwd=folder, capture_output=True, text=True)
            if made.returncode != 0 or ("secret" in line and ": YSB0b2tlbg==" not in made.stdout):
                wrong.append(f"{line}: {made.stderr}{made.stdout}")
    pods = "".join((FOLDER / name).read_text() for name in ("base/statefulset.yaml", "many/kustomization.yaml"))
    for words in (line.split() for line in lines if " generic " in line):
        secret = words[words.index("generic") + 1]
        if f"secretName: {secret}," not in pods:
            wrong.append(f"docker/README.md makes the secret {secret}, which no pod names")
    print(f"{len(lines)} lines of docker/README.md that create objects: without a cluster")
    return wrong


def main():
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    command = renderer()
    try:
        import kubernetes_validate
        import yaml
    except ImportError:
        install()
    failed = False
    for name in ("base", "gpu", "example", "many"):
        rendered = subprocess.run([*command, FOLDER / name], check=True, capture_output=True, text=True).stdout
        objects = [document for document in yaml.safe_load_all(rendered) if document]
        for version in VERSIONS:
            for item in objects:
                try:
                    kubernetes_validate.validate(item, version, strict=True)
                except kubernetes_validate.ValidationError as error:
                    failed = True
                    print(f"{name}: {item['kind']} in {version}: {error.message}", file=sys.stderr)
        for wrong in check(name, {item["kind"]: item for item in objects}) + (check_many(objects) if name == "many" else []):
            failed = True
            print(f"{name}: {wrong}", file=sys.stderr)
        print(f"{name}: {', '.join(item['kind'] for item in objects)}: Kubernetes {', '.join(VERSIONS)}")
    for wrong in check_readme():
        failed = True
        print(wrong, file=sys.stderr)
    sys.exit(failed)


if __name__ == "__main__":
    main()
