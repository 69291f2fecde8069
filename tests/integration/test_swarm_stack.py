#!/usr/bin/env python3
"""deploy/swarm without a swarm: SOURCE BUILD_FOLDER. What it names agrees with itself, the images and the programs, and `docker stack
config` takes it, where there is one. Exit code 77: python3-yaml is missing."""

import os
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile
import unittest

try:
    import yaml
except ImportError as missing:
    print(f"skipped: {missing} (Debian: python3-yaml)")
    sys.exit(77)

SOURCE, BUILD = (pathlib.Path(argument).resolve() for argument in sys.argv[1:3])
FILE = SOURCE / "deploy/swarm/stack.yaml"
STACK = yaml.safe_load(FILE.read_text())
SERVICES = STACK["services"]


def options(name):
    return dict(word.removeprefix("--").partition("=")[::2] for word in SERVICES[name]["command"])


class Stack(unittest.TestCase):
    def test_docker_takes_it(self):
        docker = shutil.which("docker")
        if docker is None or subprocess.run([docker, "stack", "config", "--help"], capture_output=True).returncode != 0:
            self.skipTest("no docker with `stack config`")
        done = subprocess.run([docker, "stack", "config", "-c", FILE], capture_output=True, text=True)
        self.assertEqual(done.returncode, 0, done.stderr)
        with tempfile.NamedTemporaryFile("w", suffix=".yaml") as broken:
            broken.write(FILE.read_text().replace("endpoint_mode:", "endpoint_mod:", 1))
            broken.flush()
            self.assertNotEqual(subprocess.run([docker, "stack", "config", "-c", broken.name], capture_output=True).returncode, 0)

    def test_every_service_has_an_address_for_each_replica(self):
        for name, service in SERVICES.items():
            self.assertEqual(service["deploy"]["endpoint_mode"], "dnsrr", name)
            for port in service.get("ports", []):
                self.assertEqual(port["mode"], "host", "the other mode needs a virtual address")

    def test_the_coordinator_finds_the_stages_by_name(self):
        stages = SERVICES.keys() - {"coordinator"}
        for stage in stages:
            port = options(stage)["listen"].rpartition(":")[2]
            self.assertEqual(options("coordinator")[stage], f"dns:///{stage}:{port}")
            self.assertTrue(set(SERVICES[stage]["networks"]) & set(SERVICES["coordinator"]["networks"]))
            self.assertNotIn("ports", SERVICES[stage])
        self.assertEqual(SERVICES["coordinator"]["deploy"]["replicas"], 1)

    def test_probes_ask_the_own_port_for_services_that_are(self):
        proto = "\n".join(file.read_text() for file in (SOURCE / "proto/pleat/v1").glob("*.proto"))
        for name, service in SERVICES.items():
            test = service["healthcheck"]["test"]
            self.assertIn("localhost:" + options(name)["listen"].rpartition(":")[2], test)
            self.assertIn(f"service {test[4].rpartition('.')[2]} {{", proto)

    def test_images_are_those_of_docker(self):
        recipe = (SOURCE / "docker/Dockerfile").read_text()
        targets = set(re.findall(r"^FROM \S+ AS (\S+)", recipe, re.MULTILINE))
        uid = re.search(r"useradd .*--uid (\d+)", recipe)[1]
        for service in SERVICES.values():
            image = re.fullmatch(r"\$\{PLEAT_REGISTRY:-\}pleat-(\w+):\$\{PLEAT_TAG:-latest\}", service["image"])
            self.assertIn(image[1], targets)
            self.assertEqual({secret["uid"] for secret in service["secrets"]}, {uid})

    def test_options_are_those_of_the_programs(self):
        for name in SERVICES:
            program = BUILD / "bin" / f"pleat-{name}"
            if not program.exists():
                self.skipTest(f"{program.name} was not built")
            said = subprocess.run([program, "--help"], capture_output=True, text=True, env={**os.environ}).stdout
            for option in options(name):
                self.assertRegex(said, re.escape("--" + option) + r"\b", name)

    def test_secrets_are_what_make_certificates_gives_a_service(self):
        with tempfile.TemporaryDirectory() as made:
            subprocess.run([SOURCE / "deploy/certificates/make-certificates.sh", made, "coordinator"], check=True,
                           stdout=subprocess.DEVNULL)
            given = {file.name for file in (pathlib.Path(made) / "service").iterdir()}
        self.assertEqual({secret["file"].rpartition("/service/")[2] for secret in STACK["secrets"].values()}, given)
        for service in SERVICES.values():
            targets = {secret["source"]: secret["target"] for secret in service["secrets"]}
            self.assertEqual(targets, {name: secret["file"].rpartition("/")[2] for name, secret in STACK["secrets"].items()})
            text = " ".join([*service["command"], *service["environment"].values()])
            self.assertLessEqual(set(re.findall(r"/run/secrets/([\w.]+)", text)), set(targets.values()))


unittest.main(argv=sys.argv[:1], verbosity=2)
