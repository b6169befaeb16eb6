#!/usr/bin/env bash
# Builds the image, brings docker/compose.yml and docker/compose.cluster.yml up by podman, runs the sample on both, kills
# parts, upgrades, backs up and restores, compares bytes, and takes everything down. As root on Debian 12:
#
#     make verify-containers
#
# All networks are made in a network namespace of its own: interfaces of the machine stay as they are. Images that no
# registry has are stood in for by Debian's packages (standins.sh). The files are in build/containers; they and the images
# stay, so that another run begins where the first had built everything. `podman rmi --all` removes the images.
set -euo pipefail
HERE=$(cd "$(dirname "$0")" && pwd)
ROOT=$(cd "$HERE/../.." && pwd)
WORK=${MULTICAP_VERIFY_FOLDER:-$ROOT/build/containers}
BASES=(python:3.11-slim-bookworm node:24-bookworm-slim postgres:15-bookworm redis:7-bookworm caddy:2.10.2
    chrislusf/seaweedfs:4.48)
MAX_IMAGE_BYTES=1200000000
# Longest time in which a part becomes ready, also on a busy machine.
PATIENCE_S=600
SITE=capture.example
PROJECT=multicap-verify
. "$HERE/standins.sh"

say() { printf '[%4d s] %s\n' $((SECONDS + ${STARTED_S:-0})) "$*"; }
fail() { say "FAILED: $*"; exit 1; }

install_programs() {
    command -v podman >/dev/null && command -v debootstrap >/dev/null && command -v aardvark-dns >/dev/null \
        || [ -x /usr/lib/podman/aardvark-dns ] || {
        apt-get update -qq
        DEBIAN_FRONTEND=noninteractive apt-get install -qq --yes --no-install-recommends podman runc buildah debootstrap \
            netavark aardvark-dns uidmap iptables >/dev/null
    }
    [ -x "$WORK/tools/bin/podman-compose" ] || {
        python3 -m venv "$WORK/tools"
        "$WORK/tools/bin/pip" install --quiet podman-compose==1.6.0 kubernetes-validate==1.37.0
    }
    # runc also works where control groups are of both versions; limits on open files can't be raised everywhere.
    cat >"$WORK/containers.conf" <<-END
	[engine]
	runtime = "runc"
	[network]
	network_backend = "netavark"
	[containers]
	default_ulimits = ["nofile=4096:4096", "nproc=4096:4096"]
	END
}

build_image() {
    local options bytes
    mapfile -t options < <(package_options)
    podman build --network host "${options[@]}" --file "$ROOT/docker/multicap.Dockerfile" --tag multicap:1 "$ROOT" \
        >"$WORK/build.log" 2>&1 || { tail -n 30 "$WORK/build.log"; fail "the image was not built"; }
    bytes=$(podman image inspect --format '{{.Size}}' multicap:1)
    say "multicap:1 has $((bytes / 1000000)) MB"
    [ "$bytes" -le $MAX_IMAGE_BYTES ] || fail "the image has more than $((MAX_IMAGE_BYTES / 1000000)) MB"
    # Another version: stages have other code and the same results.
    podman build --quiet --network none --tag multicap:2 - >/dev/null <<-END
	FROM localhost/multicap:1
	USER 0
	RUN echo "UNUSED = 1" >> /opt/multicap/lib/python3.11/site-packages/multicap/pipeline/export/results.py
	USER 10001
	END
    [ -d "$WORK/home/samples" ] || {
        mkdir -p "$WORK/home"
        podman run --rm --network host --user 0 "${options[@]}" --env MULTICAP_HOME=/home/multicap-verify \
            --volume "$WORK/home:/home/multicap-verify" multicap:1 multicap samples install >/dev/null
    }
}

# Programs that have no packages here, `kustomize` and KEDA, are not run.
check_files() {
    local path
    for path in "$ROOT"/deploy/kubernetes/base/*.yaml; do
        [ "${path##*/}" = kustomization.yaml ] || "$WORK/tools/bin/kubernetes-validate" --strict --quiet -k 1.33 "$path"
    done
    if command -v promtool >/dev/null; then (cd "$ROOT/deploy/monitoring" && promtool test rules alerts_test.yml)
    elif podman image exists multicap-verify-services; then
        podman run --rm --network none --entrypoint promtool --volume "$ROOT/deploy/monitoring:/rules:ro" \
        multicap-verify-services test rules /rules/alerts_test.yml
    else echo "promtool is not installed: the alerts are not checked"; fi
}

# The same choices without a service: what every run below must give byte by byte.
quiet_run() {
    rm -rf "$WORK/expected"
    install -d -m 777 "$WORK/expected"
    podman run --rm --network none --read-only --tmpfs /tmp --cap-drop ALL --env MULTICAP_CACHE_HOME=/tmp/cache \
        --volume $PROJECT-kernels:/opt/multicap-home/kernels \
        --volume "$SAMPLE:/sample:ro" --volume "$WORK/expected:/expected" multicap:1 \
        multicap reconstruct --videos /sample/videos --calibration "/sample/calibration/$(ls "$SAMPLE/calibration")" --out /expected/results \
        >"$WORK/reconstruct.log" 2>&1 || { tail -n 20 "$WORK/reconstruct.log"; fail "the quiet run failed"; }
    podman volume rm $PROJECT-kernels >/dev/null
}

compose() {
    MULTICAP_VERSION=$VERSION "$WORK/tools/bin/podman-compose" --project-name $PROJECT --file "$FILE" \
        --file "$WORK/slow.yml" "$@" >>"$WORK/compose.log" 2>&1 || { tail -n 20 "$WORK/compose.log"; fail "podman-compose $*"; }
}
containers() { podman ps --format "{{.Names}}" --filter "name=${PROJECT}_$1_" | sed -n 1p; }
# A container that is killed, and not started again before the script does it.
kill_container() {
    podman kill --signal KILL "$1" >/dev/null
    podman stop --time 0 "$1" >/dev/null 2>&1 || true
    [ "$(podman inspect --format '{{.State.Running}}' "$1")" = false ] || fail "$1 was killed and runs"
    say "killed $1"
}
start_container() { podman start "$1" >>"$WORK/compose.log" 2>&1; }
# A program in the image, on the host's network as a client would be; TRUST has the proxy's authority once it exists.
TRUST=()
outside() {
    podman run --rm --network host --user 0 --env KEY="${KEY:-}" --add-host "$SITE:127.0.0.1" "${TRUST[@]}" \
        --volume "$HERE/take.py:/take.py:ro" --volume "$SAMPLE:/sample:ro" \
        --volume "$WORK/expected/results:/expected:ro" --volume "$WORK/watch:/watch:ro" multicap:1 python -P "$@"
}
client() { outside /take.py "$@"; }
status() { outside -c "import urllib.request as r; r.urlopen('$1', timeout=10)"; }
wait_until() { # what, command
    local end=$((SECONDS + PATIENCE_S)) what=$1
    shift
    until "$@" >/dev/null 2>&1; do
        [ $SECONDS -lt $end ] || fail "waited in vain: $what"
        sleep 1
    done
    say "$what"
}
healthy() { podman healthcheck run "$(containers "$1")"; }

down() {
    FILE=$1
    VERSION=1 compose down --volumes --timeout 20
}

# Checks of sessions have more time: the machine may be busy.
slow() {
    printf 'services:\n' >"$WORK/slow.yml"
    printf '  %s: {environment: {MULTICAP_PREFLIGHT_TIMEOUT_S: "180"}}\n' "$@" >>"$WORK/slow.yml"
}

small() {
    slow api
    FILE=$ROOT/docker/compose.yml VERSION=1
    compose up --detach --no-build
    wait_until "compose.yml is ready" status http://127.0.0.1:8000/readyz
    local job
    job=$(client send http://127.0.0.1:8000)
    client finish http://127.0.0.1:8000 "$job" /expected
    client crowd http://127.0.0.1:8000
    healthy proxy && healthy api && healthy redis || fail "health checks of compose.yml"
    down "$FILE"
    say "compose.yml is down"
}

# Steps of docs/operate/containers.md, in their order; the backup is of docs/operate/backup.md.
cluster() {
    slow api-1 api-2
    FILE=$ROOT/docker/compose.cluster.yml VERSION=1
    export MULTICAP_SITE=$SITE
    sh "$ROOT/docker/make_secrets.sh"
    compose up --detach --no-build postgres redis s3 bucket
    wait_until "PostgreSQL is healthy" healthy postgres
    wait_until "the S3 server is healthy" healthy s3
    wait_until "Redis is healthy" healthy redis
    KEY=$(run_once api-1 multicap keys create studio --tenant studio-a --json | tail -n 1 | sed -E 's/.*"key": "([^"]+)".*/\1/')
    [[ $KEY == mc_* ]] || fail "no key"
    compose up --detach --no-build
    wait_until "the proxy has its authority" authority
    wait_until "compose.cluster.yml is ready" status https://$SITE/readyz
    local name worker
    for name in proxy api-1 api-2 worker; do wait_until "$name is healthy" healthy $name; done
    refuses_strangers

    FIRST=$(client send https://$SITE)
    worker=$(containers worker)
    kill_container "$worker"
    local watching upload
    watch
    # An upload comes in thirds, each with a cut in a piece: the second while api-1 is away, the last while api-2 is away.
    upload=$(client begin https://$SITE)
    continue_upload 1
    for name in api-1 api-2; do
        kill_container "${PROJECT}_${name}_1"
        continue_upload $((${name#api-} + 1))
        start_container "${PROJECT}_${name}_1"
        wait_until "$name is healthy again" healthy $name
        sleep 3
    done
    start_container "$worker"
    unwatch "while API processes were killed"
    podman restart --time 5 "$(containers proxy)" >>"$WORK/compose.log" 2>&1
    wait_until "the proxy answers again" status https://$SITE/healthz
    client finish https://$SITE "$FIRST" /expected
    client crowd https://$SITE

    SECOND=$(client send https://$SITE "$upload")
    upgrade
    client finish https://$SITE "$SECOND" /expected
    backup_and_restore
    down "$FILE"
    say "compose.cluster.yml is down"
}

continue_upload() { # third of the first video
    local progress
    progress=$(client continue https://$SITE "$upload" "$1")
    say "$progress"
}

# Requests without a pause until `unwatch`; each must be answered.
watch() {
    rm -f "$WORK/watch/end"
    client watch https://$SITE >"$WORK/watch.log" 2>&1 &
    watching=$!
}
unwatch() { # what was done meanwhile
    touch "$WORK/watch/end"
    wait "$watching" || { cat "$WORK/watch.log"; fail "a request was not answered $1"; }
    say "$1: $(cat "$WORK/watch.log")"
}

authority() {
    podman cp "$(containers proxy):/data/caddy/pki/authorities/local/root.crt" "$WORK/root.crt"
    TRUST=(--volume "$WORK/root.crt:/authority.crt:ro" --env SSL_CERT_FILE=/authority.crt)
}
run_once() { # service, command: in a container of its own, as `docker compose run` does
    local service=$1
    shift
    MULTICAP_VERSION=$VERSION "$WORK/tools/bin/podman-compose" --project-name $PROJECT --file "$FILE" \
        --file "$WORK/slow.yml" run --rm --no-deps -T "$service" "$@" 2>>"$WORK/compose.log"
}
said() { # service, command: its output, whatever its exit status
    local name
    name=$(containers "$1")
    shift
    podman exec "$name" "$@" 2>&1 || true
}
refuses_strangers() {
    ! KEY='' client send https://$SITE >/dev/null 2>&1 || fail "a request without a key was accepted"
    said redis redis-cli ping | grep -q NOAUTH || fail "Redis answers without its password"
    said worker python -P -c "import pathlib; pathlib.Path('/home/multicap/x').touch()" | grep -q "Read-only" || fail "a worker's root can be written"
    for name in worker api-1 redis postgres; do
        podman exec "$(containers $name)" grep -q "^CapEff:.*0000000000000000" /proc/1/status \
            || fail "$name has capabilities"
    done
    said worker python -P -c "import socket; socket.create_connection(('192.0.2.1', 9), 3)" | grep -q "unreachable" || fail "a worker has a way out"
    say "no key, no password, written roots, capabilities and ways out are refused"
}

# One program after another; a job runs meanwhile, and requests are answered.
upgrade() {
    local watching service
    watch
    VERSION=2
    for service in api-1 api-2 worker reaper; do
        compose up --detach --no-build --no-deps --force-recreate $service
        [ $service = reaper ] || wait_until "$service of version 2 is healthy" healthy $service
    done
    unwatch "during the upgrade"
    if podman ps --format '{{.Names}} {{.Image}}' --filter "name=$PROJECT" | grep -E "_(api-.|worker|reaper)_" | grep -v ":2$"; then
        fail "a container of version 1 is left"
    fi
}

# Programs that write are stopped; then the dump of the database, then the objects; the way back is the same.
backup_and_restore() {
    local volume=${PROJECT}_objects
    compose stop --timeout 30 proxy api-1 api-2 worker reaper
    podman exec "$(containers postgres)" pg_dump --username multicap --format custom multicap >"$WORK/database.dump"
    compose stop --timeout 30 s3
    podman volume export $volume >"$WORK/objects.tar"
    compose down --timeout 30
    podman volume rm $volume ${PROJECT}_database >/dev/null
    say "backed up, and the volumes of database and objects are gone"
    podman volume create $volume >/dev/null
    podman volume import $volume "$WORK/objects.tar"
    compose up --detach --no-build postgres redis s3
    wait_until "PostgreSQL is healthy" healthy postgres
    podman exec --interactive "$(containers postgres)" pg_restore --username multicap --dbname multicap --exit-on-error \
        <"$WORK/database.dump"
    compose up --detach --no-build
    wait_until "the restored service is ready" status https://$SITE/readyz
    client finish https://$SITE "$FIRST" /expected
    client finish https://$SITE "$SECOND" /expected
    rm "$WORK/objects.tar" "$WORK/database.dump"
}

# Volumes without a name outlive their containers: they are ours if they are new.
unnamed_volumes() { podman volume ls --quiet | sed -nE '/^[0-9a-f]{64}$/p' | sort; }
clean_up() {
    say "taking everything down"
    touch "$WORK/watch/end"
    for FILE in "$ROOT"/docker/compose*.yml; do
        MULTICAP_SITE=$SITE MULTICAP_VERSION=1 "$WORK/tools/bin/podman-compose" --project-name $PROJECT --file "$FILE" \
            down --volumes --timeout 5 >>"$WORK/compose.log" 2>&1 || true
    done
    podman volume rm --force ${PROJECT}_objects >/dev/null 2>&1 || true  # the restored one is no volume of podman-compose
    unnamed_volumes | comm -13 "$WORK/volumes" - | xargs --no-run-if-empty podman volume rm >/dev/null
}

inside() {
    export CONTAINERS_CONF=$WORK/containers.conf
    SAMPLE=$(echo "$WORK"/home/samples/*/videos)
    SAMPLE=${SAMPLE%/videos}
    ip link set lo up
    unnamed_volumes >"$WORK/volumes"
    trap clean_up EXIT
    small
    cluster
}

if [ "${1:-}" = inside ]; then
    inside
    exit
fi
mkdir -p "$WORK/watch"
: >"$WORK/compose.log"
export CONTAINERS_CONF=$WORK/containers.conf
install_programs
say "programs are installed"
make_bases "${BASES[@]}"
say "bases are present"
check_files
say "objects of Kubernetes and alerts are valid"
build_image
SAMPLE=$(echo "$WORK"/home/samples/*/videos)
SAMPLE=${SAMPLE%/videos}
quiet_run
say "the quiet run is done"
STARTED_S=$SECONDS unshare --net bash "$0" inside
say "all of it passed"
