#!/bin/sh
# Passwords and keys of compose.cluster.yml, random, in docker/secrets; files that exist are kept.
# The folder is closed to others; the files are not, because the programs in the containers have users of their own.
set -eu
folder=${1:-$(dirname "$0")/secrets}
umask 077
mkdir -p "$folder"
chmod 700 "$folder"

random() { od -An -N24 -tx1 /dev/urandom | tr -d ' \n'; }
keep() { # name: text of a new file on standard input
    [ -e "$folder/$1" ] || cat >"$folder/$1"
    chmod 444 "$folder/$1"
}
value() { cat "$folder/$1"; }

random | keep database_password
random | keep redis_password
random | keep s3_key_id
random | keep s3_secret_key
printf 'postgresql://multicap:%s@postgres/multicap' "$(value database_password)" | keep database_url
printf 'redis://:%s@redis:6379/0' "$(value redis_password)" | keep broker_url
printf 'requirepass %s\nsave ""\n' "$(value redis_password)" | keep redis.conf
keep s3.json <<END
{"identities": [{"name": "multicap", "actions": ["Read:multicap", "Write:multicap", "List:multicap", "Tagging:multicap"],
  "credentials": [{"accessKey": "$(value s3_key_id)", "secretKey": "$(value s3_secret_key)"}]}]}
END
