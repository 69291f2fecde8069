#!/usr/bin/env bash
# Builds the images, starts deploy/compose.yaml, runs the demo job against the coordinator from the command line's image,
# and takes everything down again. Usage: docker/compose-demo.sh [OUT_DIR] [pleat run options...]
# Needs a Docker engine and docker-compose (Debian: docker.io docker-compose).
set -euo pipefail
cd "$(dirname "$0")/.."
out=${1:-out/compose-demo}
shift || true
mkdir -p "$out"
out=$(cd "$out" && pwd)
docker info >/dev/null 2>&1 || { echo "compose-demo: no Docker engine answers; start one (Debian: apt-get install docker.io docker-compose)" >&2; exit 1; }
# The classic builder needs no plug-in and no download of a front end.
export DOCKER_BUILDKIT=0 COMPOSE_DOCKER_CLI_BUILD=0 COMPOSE_PROJECT_NAME=pleat
revision=$(git rev-parse --short HEAD 2>/dev/null || echo unknown)
build() { docker build -q --network host -f docker/Dockerfile --build-arg GIT_REVISION="$revision" --target "$1" -t "pleat-$1" . >/dev/null; }
for image in build simulation conversion superres fold refinement coordinator cli; do
  echo "compose-demo: image pleat-$image"
  build "$image"
done

# The keys are readable for the image's user only through the mount: the demo's own authority, made anew and thrown away.
certificates=$(mktemp -d)
export PLEAT_CERTIFICATES=$certificates
compose() { docker-compose -f deploy/compose.yaml "$@"; }
cleanup() {
  compose logs --no-color >"$out/services.log" 2>&1 || true
  compose down -v --timeout 20 >/dev/null 2>&1 || true
  rm -rf "$certificates"
}
trap cleanup EXIT
deploy/certificates/make-certificates.sh "$certificates" coordinator localhost 127.0.0.1 >/dev/null
chmod 755 "$certificates" "$certificates/service" && chmod 644 "$certificates"/service/* "$certificates"/{ca,client}.crt "$certificates/client.key"

echo "compose-demo: starting the services"
compose up -d --no-build 2>&1 | tail -n 8
for _ in $(seq 90); do
  [[ $(docker inspect -f '{{.State.Health.Status}}' pleat_coordinator_1 2>/dev/null) == healthy ]] && break
  sleep 1
done
docker inspect -f '{{.Name}} {{.State.Health.Status}}' $(compose ps -q)

echo "compose-demo: the demo job, against the coordinator"
docker run --rm --network pleat_pleat --user "$(id -u):$(id -g)" -v "$certificates/ca.crt:/certificates/ca.crt:ro" \
  -v "$certificates/client.crt:/certificates/client.crt:ro" -v "$certificates/client.key:/certificates/client.key:ro" -v "$out:/out" \
  -e PLEAT_TLS_CA=/certificates/ca.crt -e PLEAT_TLS_CERTIFICATE=/certificates/client.crt -e PLEAT_TLS_KEY=/certificates/client.key \
  pleat-cli run /usr/local/share/pleat/deploy/scenes/draping.json --coordinator coordinator:50050 --out /out "$@"
curl -fsS http://127.0.0.1:9468/metrics 2>/dev/null | grep -c '^pleat_' | sed 's/^/compose-demo: metrics lines of the coordinator: /' || true
echo "compose-demo: $out/report.html"
