#!/bin/sh
# The first process of a container. With it the kernel ends all others, at once: if the server were the first one, nobody
# would be left to send the zeros when it is killed. So it is a child, and after its end bridge and stopper have their time.
PATIENCE_S=7 # the stopper needs 5 s at most (LATE_S and GIVE_UP_AFTER_S in stopper.py); docker stop waits for 10 s

exec 3<&0 # what runs in the background has no stdin of its own
ros2-mcp "$@" <&3 3<&- &
server=$!
exec 3<&- 0</dev/null
trap 'kill -TERM "$server" 2>/dev/null' TERM INT HUP

code=0
while :; do # a signal ends the wait, not the server
    wait "$server"
    code=$?
    kill -0 "$server" 2>/dev/null || break
done

# Processes beside this one and the first, which is another one with docker run --init; the dead do not count.
others() {
    for folder in /proc/[0-9]*; do
        case ${folder#/proc/} in 1 | "$$") continue ;; esac
        [ -d "$folder" ] && ! grep -qs '^State:.Z' "$folder/status" && return 0
    done
    return 1
}

turns=$((PATIENCE_S * 10))
while others && [ "$turns" -gt 0 ]; do
    sleep 0.1
    turns=$((turns - 1))
done
exit "$code"
