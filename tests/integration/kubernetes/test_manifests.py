#!/usr/bin/env python3
"""deploy/kubernetes without a cluster: SOURCE BUILD_FOLDER. Against the schemas of Kubernetes' API, where npm gets them; and names,
labels, ports, images, options and metrics against each other and against the programs. Exit code 77: python3-yaml is missing."""

import json
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
HERE = pathlib.Path(__file__).resolve().parent
DEPLOY = SOURCE / "deploy/kubernetes"
FOLDERS = (DEPLOY, DEPLOY / "data")
# Made by hand, as README.md says, and what is in it: `service` of make-certificates.sh.
SECRETS = {"pleat-tls": {"ca.crt", "ca.crl", "server.key", "server.crt", "health.key", "health.crt"}}


def kustomization(folder):
    return yaml.safe_load((folder / "kustomization.yaml").read_text())


def files(folder):
    return [folder / name for name in kustomization(folder)["resources"]]


def objects(folder):
    return [each for file in files(folder) for each in yaml.safe_load_all(file.read_text())]


def pod(workload):
    return workload["spec"]["template"]["spec"]


def workloads(folder):
    return [o for o in objects(folder) if o["kind"] in ("Deployment", "StatefulSet", "Job")]


def selects(selector, labels):
    """Whether labels have all that a map of labels asks for."""
    return all(labels.get(key) == value for key, value in selector.items())


def checkers():
    """The folder with the packages of package.json, installed once for a build; None without npm or network."""
    folder = BUILD / "manifest_checkers"
    if shutil.which("npm") is None:
        return None
    folder.mkdir(exist_ok=True)
    for name in ("package.json", "package-lock.json", "check_manifests.mjs"):
        shutil.copy(HERE / name, folder)
    lock = (HERE / "package-lock.json").read_text()
    installed = folder / "installed"
    if not installed.exists() or installed.read_text() != lock:
        if subprocess.run(["npm", "ci", "--silent", "--no-audit", "--no-fund"], cwd=folder, timeout=120).returncode != 0:
            return None
        installed.write_text(lock)
    return folder


class Schemas(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.folder = checkers()
        if cls.folder is None:
            raise unittest.SkipTest("npm or its packages are not to be had: the API's schemas are not checked")

    def check(self, *paths):
        return subprocess.run(["node", "check_manifests.mjs", *map(str, paths)], cwd=self.folder, stdout=subprocess.PIPE,
                              stderr=subprocess.STDOUT, text=True)

    def test_every_object_is_one_of_the_api(self):
        done = self.check(*(file for folder in FOLDERS for file in files(folder)))
        self.assertEqual(done.returncode, 0, done.stdout)
        self.assertIn(f"{sum(len(objects(folder)) for folder in FOLDERS)} objects checked", done.stdout)

    def test_what_kustomize_makes_of_them_too(self):
        if shutil.which("kubectl") is None:
            self.skipTest("no kubectl")
        with tempfile.TemporaryDirectory() as made:
            for folder in FOLDERS:
                done = subprocess.run(["kubectl", "kustomize", folder], capture_output=True, text=True)
                self.assertEqual(done.returncode, 0, done.stderr)
                (pathlib.Path(made) / f"{folder.name}.yaml").write_text(done.stdout)
            done = self.check(*pathlib.Path(made).iterdir())
            self.assertEqual(done.returncode, 0, done.stdout)

    def test_the_checker_finds_faults(self):
        whole = (DEPLOY / "fold.yaml").read_text()
        faults = {"minReadySecond: 3": "minReadySecond", "minReadySeconds: soon": "minReadySeconds", "selector: {}": 'matchLabel'}
        for line, named in faults.items():
            with self.subTest(line), tempfile.TemporaryDirectory() as made:
                file = pathlib.Path(made) / "fold.yaml"
                if line == "selector: {}":
                    file.write_text(re.sub(r"matchLabels: ", "matchLabel: ", whole, count=1))
                else:
                    file.write_text(whole.replace("spec:\n", f"spec:\n  {line}\n", 1))
                done = self.check(file)
                self.assertEqual(done.returncode, 1, done.stdout)
                self.assertIn(named, done.stdout)


class Agreement(unittest.TestCase):
    def test_all_files_are_in_a_kustomization(self):
        for folder in FOLDERS:
            self.assertEqual({f.name for f in files(folder)} | {"kustomization.yaml"}, {f.name for f in folder.glob("*.yaml")})
        for generator in kustomization(DEPLOY)["configMapGenerator"]:
            for name in generator["files"]:
                self.assertTrue((DEPLOY / name).exists(), name)

    def test_selectors_select_their_pods(self):
        for folder in FOLDERS:
            for o in workloads(folder):
                labels = o["spec"]["template"]["metadata"]["labels"]
                if "selector" in o["spec"]:
                    self.assertTrue(selects(o["spec"]["selector"]["matchLabels"], labels), o["metadata"]["name"])
            pods = [o["spec"]["template"]["metadata"]["labels"] for o in workloads(folder)]
            for o in objects(folder):
                name, spec = (o["kind"], o["metadata"]["name"]), o.get("spec", {})
                if o["kind"] == "Service":
                    self.assertEqual(sum(selects(spec["selector"], labels) for labels in pods), 1, name)
                elif o["kind"] == "PodDisruptionBudget":
                    self.assertEqual(sum(selects(spec["selector"]["matchLabels"], labels) for labels in pods), 1, name)
                elif o["kind"] == "NetworkPolicy":
                    selectors = [spec["podSelector"]] + [peer["podSelector"] for rule in
                                 spec.get("ingress", []) + spec.get("egress", [])
                                 for peer in rule.get("from", []) + rule.get("to", []) if "podSelector" in peer]
                    for selector in selectors:
                        self.assertTrue(any(selects(selector.get("matchLabels", {}), labels) for labels in pods), name)

    def test_ports_are_those_that_programs_listen_at(self):
        listening = {}
        for o in workloads(DEPLOY):
            container = pod(o)["containers"][0]
            ports = {p["name"]: p["containerPort"] for p in container["ports"]}
            arguments = dict(word.removeprefix("--").partition("=")[::2] for word in container["args"])
            self.assertEqual(arguments["listen"], f"0.0.0.0:{ports['grpc']}")
            self.assertEqual(arguments["metrics-listen"], f"0.0.0.0:{ports['metrics']}")
            self.assertEqual(o["spec"]["template"]["metadata"]["annotations"]["prometheus.io/port"], str(ports["metrics"]))
            for probe in ("startupProbe", "readinessProbe", "livenessProbe"):
                self.assertIn(f"localhost:{ports['grpc']}", container[probe]["exec"]["command"])
            listening[o["metadata"]["name"]] = ports
        services = {o["metadata"]["name"]: o["spec"] for o in objects(DEPLOY) if o["kind"] == "Service"}
        self.assertEqual(services.keys(), listening.keys())
        for name, spec in services.items():
            self.assertEqual({p["targetPort"]: p["port"] for p in spec["ports"]}, listening[name])
            self.assertEqual(spec.get("clusterIP") == "None", name != "coordinator", "stages have headless services")
        # The coordinator finds each stage by its service, and its policies let it.
        coordinator = next(o for o in workloads(DEPLOY) if o["metadata"]["name"] == "coordinator")
        words = pod(coordinator)["containers"][0]["args"]
        policies = {o["metadata"]["name"]: o["spec"] for o in objects(DEPLOY) if o["kind"] == "NetworkPolicy"}
        leaving = {p["port"] for p in policies["coordinator-egress"]["egress"][0]["ports"]}
        for stage, ports in listening.items():
            if stage == "coordinator":
                continue
            self.assertIn(f"--{stage}=dns:///{stage}:{ports['grpc']}", words)
            self.assertEqual(policies[f"coordinator-to-{stage}"]["ingress"][0]["ports"], [{"port": ports["grpc"]}])
            self.assertIn(ports["grpc"], leaving)

    def test_probes_ask_for_the_services_by_their_names(self):
        proto = "\n".join(file.read_text() for file in (SOURCE / "proto/pleat/v1").glob("*.proto"))
        for o in workloads(DEPLOY):
            asked = next(word for word in pod(o)["containers"][0]["readinessProbe"]["exec"]["command"]
                         if word.startswith("pleat.v1."))
            self.assertIn(f"service {asked.rpartition('.')[2]} {{", proto)

    def test_images_are_those_of_docker(self):
        recipes = set(re.findall(r"^FROM \S+ AS (\S+)", (SOURCE / "docker/Dockerfile").read_text(), re.MULTILINE))
        for folder in FOLDERS:
            used = {container["image"] for o in workloads(folder) for container in pod(o)["containers"]}
            self.assertLessEqual({image.removeprefix("pleat-") for image in used}, recipes)
            self.assertEqual(used, {image["name"] for image in kustomization(folder)["images"]})

    def test_options_are_those_of_the_programs(self):
        for o in workloads(DEPLOY):
            container = pod(o)["containers"][0]
            program = BUILD / "bin" / container["image"]
            if not program.exists():
                self.skipTest(f"{program.name} was not built")
            said = subprocess.run([program, "--help"], capture_output=True, text=True).stdout
            for word in container["args"]:
                self.assertRegex(said, re.escape(word.partition("=")[0]) + r"\b", container["image"])

    def test_what_is_mounted_exists(self):
        for folder in FOLDERS:
            claims = {o["metadata"]["name"] for o in objects(folder) if o["kind"] == "PersistentVolumeClaim"}
            for o in workloads(folder):
                volumes = {v["name"]: v for v in pod(o).get("volumes", [])}
                volumes.update({c["metadata"]["name"]: {} for c in o["spec"].get("volumeClaimTemplates", [])})
                container = pod(o)["containers"][0]
                mounts = {m["name"]: m["mountPath"] for m in container["volumeMounts"]}
                self.assertEqual(mounts.keys(), volumes.keys(), o["metadata"]["name"])
                for volume in volumes.values():
                    if "secret" in volume:
                        self.assertIn(volume["secret"]["secretName"], SECRETS)
                    if "persistentVolumeClaim" in volume:
                        self.assertIn(volume["persistentVolumeClaim"]["claimName"], claims)
                values = [*container.get("args", []), *(e.get("value", "") for e in container.get("env", []))]
                for path in re.findall(r"/certificates/(\S+)", " ".join(values)):
                    self.assertIn(path, SECRETS["pleat-tls"])

    def test_the_secret_has_what_make_certificates_gives_a_service(self):
        with tempfile.TemporaryDirectory() as made:
            subprocess.run([SOURCE / "deploy/certificates/make-certificates.sh", made, "coordinator", "localhost"], check=True,
                           stdout=subprocess.DEVNULL)
            self.assertEqual({f.name for f in (pathlib.Path(made) / "service").iterdir()}, SECRETS["pleat-tls"])

    def test_pods_have_no_rights(self):
        for o in (o for folder in FOLDERS for o in workloads(folder)):
            spec, container = pod(o), pod(o)["containers"][0]
            self.assertFalse(spec["automountServiceAccountToken"])
            self.assertTrue(spec["securityContext"]["runAsNonRoot"])
            self.assertTrue(container["securityContext"]["readOnlyRootFilesystem"])
            self.assertEqual(container["securityContext"]["capabilities"], {"drop": ["ALL"]})
            self.assertIn("memory", container["resources"]["limits"])
            self.assertGreater(spec["terminationGracePeriodSeconds"], 15)
        uid = re.search(r"useradd .*--uid (\d+)", (SOURCE / "docker/Dockerfile").read_text())[1]
        self.assertTrue(all(pod(o)["securityContext"]["runAsUser"] == int(uid) for o in workloads(DEPLOY)))

    def test_the_data_job_says_how_many_places_there_are(self):
        job = next(o for o in workloads(DEPLOY / "data") if o["metadata"]["name"] == "dataset-generate")
        environment = {e["name"]: e.get("value") for e in pod(job)["containers"][0]["env"]}
        self.assertEqual(environment["JOB_COMPLETIONS"], str(job["spec"]["completions"]))
        self.assertEqual(job["spec"]["completionMode"], "Indexed")
        rules = job["spec"]["podFailurePolicy"]["rules"]
        actions = {rule["action"]: rule["onExitCodes"]["values"] for rule in rules if "onExitCodes" in rule}
        self.assertEqual(actions, {"Ignore": [75], "FailJob": [2]})
        self.assertEqual(pod(job)["restartPolicy"], "Never")

    def test_autoscalers_scale_what_is_there_by_metrics_that_are_there(self):
        rules = yaml.safe_load((DEPLOY / "monitoring/rules.yaml").read_text())
        recorded = {rule["record"] for group in rules["groups"] for rule in group["rules"] if "record" in rule}
        source = (SOURCE / "common/telemetry/metrics.cpp").read_text()
        exposed = set(re.findall(r'Name\("(pleat_\w+)"\)', source)) | {"pleat_reconnects_total"}
        texts = [rule["expr"] for group in rules["groups"] for rule in group["rules"]]
        board = json.loads((DEPLOY / "monitoring/board.json").read_text())
        texts += [target["expr"] for panel in board["panels"] for target in panel["targets"]]
        for text in texts:
            for name in re.findall(r"\bpleat_\w+", text):
                self.assertTrue({name, name.removesuffix("_bucket")} & (recorded | exposed), f"{name} in {text}")
        deployments = {o["metadata"]["name"] for o in workloads(DEPLOY) if o["kind"] == "Deployment"}
        stages = set(re.findall(r'\.stage = "(\w+)"', (SOURCE / "services/coordinator/pipeline.cpp").read_text()))
        scaled = set()
        for o in objects(DEPLOY):
            if o["kind"] != "HorizontalPodAutoscaler":
                continue
            scaled.add(o["spec"]["scaleTargetRef"]["name"])
            for metric in o["spec"]["metrics"]:
                source = metric.get("external") or metric["pods"]
                self.assertIn(source["metric"]["name"], recorded | exposed)
                if "external" in metric:
                    self.assertIn(source["metric"]["selector"]["matchLabels"]["stage"], stages)
        self.assertEqual(scaled, deployments)


unittest.main(argv=sys.argv[:1], verbosity=2)
