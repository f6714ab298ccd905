#!/usr/bin/env bash
# relievo view in a real window: a hand on mouse and keys (xdotool) under a virtual display, and what came of it.
# Usage: view_window_test.sh PROGRAM gl|es. Exit code 77: skipped, the reason on the last line.
set -euo pipefail

program=$1
export RELIEVO_GL=$2
for needed in Xvfb xdotool; do
  command -v "$needed" >/dev/null || { echo "SKIPPED: $needed is not installed (tools/setup installs it)"; exit 77; }
done

folder=$(mktemp -d)
display=
viewer=
cleanUp() {
  [ -z "$viewer" ] || kill "$viewer" 2>/dev/null || true
  [ -z "$display" ] || kill "$display" 2>/dev/null || true
  rm -rf -- "$folder"
}
trap cleanUp EXIT

# The server itself finds the number that is free; xvfb-run looks and then takes, and two at once take the same.
# -noreset: without it the server starts anew, refusing callers, whenever the last client leaves, as each xdotool does.
Xvfb -displayfd 3 -screen 0 1000x700x24 -nolisten tcp -noreset 3>"$folder/number" >/dev/null 2>"$folder/xvfb" &
display=$!
for _ in $(seq 300); do
  [ -s "$folder/number" ] && break
  kill -0 "$display" 2>/dev/null || { echo "FAILED: no virtual display:" >&2; cat "$folder/xvfb" >&2; exit 1; }
  sleep 0.1
done
DISPLAY=:$(cat "$folder/number")
export DISPLAY
unset WAYLAND_DISPLAY XAUTHORITY
cd -- "$folder"
fail() { echo "FAILED: $*" >&2; cat errors >&2; exit 1; }

"$program" sample inscription --size 256x256 --package stone.relievo >/dev/null

# start: the viewer, once its window is there.
start() {
  "$program" view stone.relievo --size 600x400 --print-view >view.json 2>errors &
  viewer=$!
  for _ in $(seq 300); do
    if xdotool search --onlyvisible --name 'stone.relievo - Relievo' >/dev/null 2>&1; then
      # It is there before the viewer listens: package and shaders come first.
      sleep 1
      return 0
    fi
    kill -0 "$viewer" 2>/dev/null || fail "the viewer ended before its window came"
    sleep 0.1
  done
  fail "no window within 30 s"
}
# finish: Escape, and the viewer's exit code.
finish() {
  xdotool key Escape
  local status=0
  wait "$viewer" || status=$?
  viewer=
  [ "$status" -eq 0 ] || fail "the viewer ended with exit code $status"
  ! grep -q 'GL error' errors || fail "GL errors"
}
# value NAME [INDEX]: a number of view.json, or one of a list.
value() {
  sed -n "s/.*\"$1\":\\[\\{0,1\\}\\([^]\"}]*\\).*/\\1/p" view.json | cut -d, -f$((${2:-0} + 1))
}
# expect NAME VALUE [INDEX]: to six digits.
expect() {
  awk -v found="$(value "$1" "${3:-0}")" -v wanted="$2" 'BEGIN {
    difference = found - wanted; if (difference < 0) difference = -difference
    size = wanted < 0 ? -wanted : wanted; if (size < 1) size = 1
    exit !(found != "" && difference <= 1e-6 * size) }' || fail "$1 was expected to be $2 in $(cat view.json)"
}
# In steps, as a hand would.
drag() {  # button dx dy
  xdotool mousedown "$1"
  for _ in 1 2 3 4 5; do xdotool mousemove_relative -- $(($2 / 5)) $(($3 / 5)); done
  xdotool mouseup "$1"
}

# Nothing done: the view is that of the start.
start
finish
expect azimuth_deg 0
expect light 1 2
grep -q '"orthographic":false' view.json || fail "the projection is not perspective in $(cat view.json)"
before=$(value distance_mm)

# 180 degrees a window's height (400 px); a wheel step is a factor of 0.85; the light moves by a hemisphere's radius
# (200 px) a unit.
start
xdotool mousemove 300 200
drag 1 -100 50
xdotool mousemove 300 200 click --repeat 2 --delay 20 4
xdotool mousemove 300 200
drag 3 60 -40
xdotool key o
finish
grep -q '"orthographic":true' view.json || fail "O did not switch the projection in $(cat view.json)"
expect azimuth_deg 45
expect elevation_deg 22.5
expect distance_mm "$(echo "$before" | awk '{ printf "%.12g", $1 * 0.85 * 0.85 }')"
expect light 0.3 0
expect light 0.2 1

# Reset undoes all of it; S writes a picture, twice under two names; W, P, F1 and F2 come and go.
start
xdotool mousemove 300 200
drag 1 -100 50
drag 3 60 -40
# Presses that fall into one slow frame make one picture: wait for it.
snapshot() {
  xdotool key s
  for _ in $(seq 300); do [ -e "$1" ] && return 0; sleep 0.1; done
  fail "S did not write $1"
}
for key in w p F1 F2; do xdotool key "$key"; done
snapshot stone-0001.png
for key in w p F1 F2; do xdotool key "$key"; done
snapshot stone-0002.png
xdotool key r
finish
expect azimuth_deg 0
expect light 0 0
for name in stone-0001.png stone-0002.png; do
  [ "$(head -c 8 $name | od -An -tx1 | tr -d ' ')" = 89504e470d0a1a0a ] || fail "$name is no PNG"
done
[ ! -e stone-0003.png ] || fail "a key press wrote more than one picture"
if cmp -s stone-0001.png stone-0002.png; then fail "wireframe and page overlay are not in the picture"; fi

# The same picture as relievo render makes; with vertices on their way between levels, as viewers draw them unless told otherwise.
"$program" view stone.relievo --size 600x400 --frames 120 --snapshot window.png 2>errors
"$program" render stone.relievo --size 600x400 --geomorph on -o headless.png
cmp window.png headless.png || fail "the window's picture is not that of relievo render"
echo "passed"
