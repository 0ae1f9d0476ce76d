#!/usr/bin/env bash
# Peak memory of a service that does one thing with one generated mesh, beyond that of an idle one,
# per vertex and per element (vertices and triangles together): what the model in
# src/service/memory.rs is measured by.
#
#   benches/memory.sh [QUADMARK]     (the binary; target/release/quadmark when not given)
set -euo pipefail
quadmark=${1:-target/release/quadmark}
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

# Starts a service over "$work/$1" and leaves its process id in $pid and its port in $port.
start() {
    port=$((20000 + RANDOM % 20000))
    "$quadmark" serve --data "$work/$1" --listen "127.0.0.1:$port" --log-level error &
    pid=$!
    until curl -sf "127.0.0.1:$port/livez" >/dev/null; do sleep 0.1; done
}
peak() { awk '/VmHWM/ { print $2 * 1024 }' "/proc/$pid/status"; }
stop() { kill "$pid"; wait "$pid" || true; }

start idle
idle=$(peak)
stop
printf 'idle: %d MiB\n%-14s%10s%10s%8s%12s%14s\n' $((idle >> 20)) what vertices triangles MiB \
    'per vertex' 'per element'
for vertices in 50000 190000 400000; do
    for kind in obj glb; do
        "$quadmark" sample blob --vertices "$vertices" -o "$work/host.$kind" 2>"$work/counts"
        read -r count triangles < <(grep -o '[0-9]* vertices, [0-9]* triangles' "$work/counts" | tr -dc '0-9 \n')
        for what in inspections watermarks verifications; do
            start "$kind-$vertices"
            field=(-F "file=@$work/host.$kind")
            [ "$what" != watermarks ] || field+=(-F owner_id=acme -F on_existing=warn)
            [ "$what" != verifications ] || field=(-F "file=@$work/half.$kind")
            code=$(curl -s -o "$work/answer" -w '%{http_code}' "${field[@]}" "127.0.0.1:$port/v1/$what")
            [ "$what" != watermarks ] || cp "$work/host.$kind" "$work/half.$kind"
            bytes=$(($(peak) - idle))
            stop
            printf '%-14s%10d%10d%8d%12d%14d  %s %s\n' "$what" "$count" "$triangles" \
                $((bytes >> 20)) $((bytes / count)) $((bytes / (count + triangles))) "$kind" "$code"
        done
    done
done
