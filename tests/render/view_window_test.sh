#!/usr/bin/env bash
# relievo view in a real window: a hand on mouse and keys (xdotool) under a virtual display, and what came of it.
# Usage: view_window_test.sh PROGRAM gl|es. Exit code 77: skipped, the reason on the last line; where RELIEVO_REQUIRE_GL=1 nothing is.
set -euo pipefail

program=$1
export RELIEVO_GL=$2
for needed in Xvfb xdotool; do
  command -v "$needed" >/dev/null && continue
  [ "${RELIEVO_REQUIRE_GL:-}" = 1 ] && { echo "FAILED: $needed is not installed (tools/setup installs it)"; exit 1; }
  echo "SKIPPED: $needed is not installed (tools/setup installs it)"
  exit 77
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

# start [OPTION...]: the viewer, once its window is there; its files may have $file_blocks blocks of 1024 bytes.
file_blocks=unlimited artwork=stone.relievo title=stone.relievo
start() {
  ( ulimit -f "$file_blocks"; exec "$program" view "$artwork" --size 600x400 --print-view "$@" >view.json 2>errors ) &
  viewer=$!
  for _ in $(seq 300); do
    if xdotool search --onlyvisible --name "$title - Relievo" >/dev/null 2>&1; then
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
# still: returns once the viewer has taken hardly any processor time for two seconds: it has nothing left to draw.
ticks() { awk '{ print $14 + $15 }' "/proc/$viewer/stat"; }
still() {
  local before after quiet=0
  before=$(ticks)
  for _ in $(seq 120); do
    sleep 0.5
    after=$(ticks)
    if [ $((after - before)) -le 5 ]; then quiet=$((quiet + 1)); else quiet=0; fi
    [ "$quiet" -lt 4 ] || return 0
    before=$after
  done
  fail "the viewer goes on drawing, for 60 s"
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

# The same picture as relievo render makes; with vertices on their way between levels, as viewers draw them unless told otherwise.
"$program" view stone.relievo --size 600x400 --frames 120 --snapshot window.png 2>errors
"$program" render stone.relievo --size 600x400 --geomorph on -o headless.png
cmp window.png headless.png || fail "the window's picture is not that of relievo render"

# What follows is about samples (multisampling_gltest tells of those of OpenGL ES), keys, mouse and files.
if [ "$RELIEVO_GL" = es ] && [ "${RELIEVO_LONG_TESTS:-}" != 1 ]; then echo "passed"; exit 0; fi

# The same with several samples a pixel, which come one by one once nothing changes.
"$program" view stone.relievo --size 600x400 --samples 4 --azimuth 40 --frames 250 --snapshot window-4.png 2>errors
"$program" render stone.relievo --size 600x400 --samples 4 --azimuth 40 --geomorph on -o headless-4.png
"$program" render stone.relievo --size 600x400 --azimuth 40 --geomorph on -o headless-1.png
cmp window-4.png headless-4.png || fail "the window's picture of 4 samples is not that of relievo render"
if cmp -s headless-4.png headless-1.png; then fail "the control shows 4 samples"; fi

# 180 degrees a window's height (400 px); a wheel step is a factor of 0.85 of the distance to the surface, which is within a few mm of the plane
# that the first distance is to; the light moves by a hemisphere's radius (200 px) a unit.
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
value distance_mm | awk -v before="$before" '{ exit !($1 > before * 0.7 && $1 < before * 0.74) }' || fail "two wheel steps from $before mm in $(cat view.json)"
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
# Beside each picture lies its scene, which relievo render draws.
grep -q '"azimuth_deg": 4[45]' stone-0001.json || fail "the scene has another camera: $(cat stone-0001.json)"
grep -q '"wireframe": true' stone-0001.json || fail "the scene has no wireframe: $(cat stone-0001.json)"
if grep -q wireframe stone-0002.json; then fail "the scene kept the wireframe"; fi
"$program" render stone-0002.json -o again.png
"$program" render stone.relievo --state view.json --geomorph on --size 600x400 -o reset.png
if cmp -s again.png reset.png; then fail "the scene is drawn as the view after the reset"; fi

# A hundred notches in, the artwork fills the window: no pixel of the background, which is 24,24,26. Zooming out leaves it whole again.
start
xdotool mousemove 330 180
for _ in 1 2 3 4 5 6 7 8 9 10; do xdotool click --repeat 10 --delay 5 4; sleep 0.2; done
snapshot stone-0003.png
finish
value distance_mm | awk -v before="$before" '{ exit !($1 > 0 && $1 < before * 0.25) }' || fail "a hundred notches in left the eye afar: $(cat view.json)"
"$program" render stone.relievo --size 600x400 --state view.json --geomorph on --background 255,0,255 -o near.png
"$program" render stone.relievo --size 600x400 --state view.json --geomorph on --background 0,255,0 -o near-too.png
cmp near.png near-too.png || fail "a hundred notches in show the background in $(cat view.json)"
"$program" render stone.relievo --size 600x400 --background 255,0,255 -o far.png
"$program" render stone.relievo --size 600x400 --background 0,255,0 -o far-too.png
if cmp -s far.png far-too.png; then fail "the control shows no background"; fi
rm stone-0003.png stone-0003.json

# A full disk: S leaves no picture rather than a broken one, nor anything beside it, and the viewer goes on.
file_blocks=8
start
xdotool key s
finish
file_blocks=unlimited
[ -z "$(find . -name 'stone-0003*')" ] || fail "S wrote $(find . -name 'stone-0003*') where the disk is full"
cp stone-0001.png kept.png
status=0
( ulimit -f 8; exec "$program" view stone.relievo --size 600x400 --frames 20 --snapshot stone-0001.png ) 2>errors || status=$?
[ "$status" -eq 2 ] || fail "a snapshot on a full disk ends with exit code $status"
grep -q 'stone-0001.png: ' errors || fail "the picture that could not be written is not named"
cmp stone-0001.png kept.png || fail "a snapshot on a full disk took the place of the one before"

# A camera that stands still is drawn exactly, where that is asked for.
start --exact-still on --error-px 2 --azimuth 50
still
snapshot stone-0003.png
finish
"$program" render stone.relievo --size 600x400 --geomorph on --error-px 2 --azimuth 50 --least-cell 0 -o exact.png
"$program" render stone.relievo --size 600x400 --geomorph on --error-px 2 --azimuth 50 -o inexact.png
cmp stone-0003.png exact.png || fail "a still camera is not drawn exactly"
if cmp -s exact.png inexact.png; then fail "the control is as exact"; fi
rm stone-0003.png stone-0003.json

# Of several lights a drag moves the first that is far away. The scene has them all, and draws the same picture.
start --exact-still on --azimuth 50 \
  --lights '[{"position_mm":[-100,60,90],"color":[1,0.6,0.3]},{"towards":[-0.6,0,0.8],"intensity":0.5},{"towards":[0,-1,1],"intensity":0}]'
xdotool mousemove 300 200
drag 3 60 -40
still
snapshot stone-0003.png
finish
expect light -0.3 0
expect light 0.2 1
"$program" render stone-0003.json -o lights.png
cmp stone-0003.png lights.png || fail "the scene of several lights is another picture: $(cat stone-0003.json)"
"$program" render stone-0003.json --light 1,0,1 -o one-light.png
if cmp -s lights.png one-light.png; then fail "the control has one light"; fi
rm stone-0003.png stone-0003.json

# Keys choose shading and effects, and which light a drag moves; the scene beside the picture says so, and draws it. (Hysteresis remembers the
# triangles of what was shown before, which a scene does not.)
start --exact-still on --hysteresis 0 --lights '[{"towards":[-0.6,0,0.8]},{"position_mm":[-100,60,90]}]'
for key in h g n; do xdotool key "$key"; done
xdotool mousemove 300 200
drag 3 60 -40
still
snapshot stone-0003.png
xdotool key m
still
snapshot stone-0004.png
finish
grep -q '"shadows": true' stone-0003.json || fail "H did not turn shadows on: $(cat stone-0003.json)"
grep -q '"reflectance": 0.04' stone-0003.json || fail "G did not turn gloss on: $(cat stone-0003.json)"
grep -q shading stone-0003.json && fail "the scene has a shading: $(cat stone-0003.json)"
grep -q '"kind": "slope"' stone-0004.json || fail "M did not show the slope: $(cat stone-0004.json)"
tr -d ' \n' <stone-0003.json | grep -q '"towards":\[-0.6,0.0,0.8\]' || fail "the drag moved the other light: $(cat stone-0003.json)"
tr -d ' \n' <stone-0003.json | grep -q '"position_mm":\[-100' && fail "the drag moved no near light: $(cat stone-0003.json)"
for picture in stone-0003 stone-0004; do
  "$program" render $picture.json -o shown.png
  cmp $picture.png shown.png || fail "the scene is another picture: $(cat $picture.json)"
done
"$program" render stone-0003.json --light 0,0,1 -o other.png
if cmp -s stone-0003.png other.png; then fail "the control has one light"; fi
rm stone-000[34].png stone-000[34].json

# Several artworks: a drag turns about the one under the mouse, and the scene beside the picture keeps all of them where they stand.
cat >two.json <<'END'
{"format": "relievo-scene", "version": 1,
 "artworks": [{"file": "stone.relievo"}, {"file": "stone.relievo", "pose": {"position_mm": [150, 40, 250], "rotate_deg": [0, -20, 90]}}]}
END
artwork=two.json title=two.json
start --exact-still on --hysteresis 0
xdotool mousemove 300 200
drag 1 40 30
still
snapshot two-0001.png
finish
artwork=stone.relievo title=stone.relievo
value azimuth_deg | awk '{ exit !($1 != 0) }' || fail "the drag did not turn: $(cat view.json)"
tr -d ' \n' <two-0001.json | grep -q '"position_mm":\[150.0,40.0,250.0\],"rotate_deg":\[0.0,-20.0,90.0\]' || fail "the scene lost a pose: $(cat two-0001.json)"
"$program" render two-0001.json -o shown.png
cmp two-0001.png shown.png || fail "the scene of two artworks is another picture: $(cat two-0001.json)"
sed 's/150.0/100.0/' two-0001.json >moved.json
"$program" render moved.json -o moved.png
if cmp -s two-0001.png moved.png; then fail "the control has another pose"; fi

# What moves by itself plays at once; Space pauses it, and S writes that moment, which does not move.
cat >film.json <<'END'
{"format": "relievo-scene", "version": 1, "artwork": "stone.relievo", "camera": {"elevation_deg": 10},
 "camera_path": [{"time_s": 0, "azimuth_deg": -40}, {"time_s": 300, "azimuth_deg": 40}],
 "lights": [{"towards": [0, 0.5, 1], "keys": [{"time_s": 0, "towards": [0, 0.5, 1]}, {"time_s": 300, "towards": [1, 0.5, 1]}]}]}
END
artwork=film.json
start --exact-still on --hysteresis 0
xdotool key space
still
snapshot stone-0003.png
finish
artwork=stone.relievo
value azimuth_deg | awk '{ exit !($1 > -40 && $1 < 20) }' || fail "the film did not play, or did not pause: $(cat view.json)"
value light 0 | awk '{ exit !($1 > 0 && $1 < 0.5) }' || fail "the light of the film stood still: $(cat view.json)"
if grep -q camera_path stone-0003.json; then fail "the scene of a moment moves"; fi
"$program" render stone-0003.json -o moment.png
cmp stone-0003.png moment.png || fail "the scene of a moment is another picture: $(cat stone-0003.json)"
"$program" render film.json --size 600x400 --geomorph on --least-cell 0 -o first.png
if cmp -s moment.png first.png; then fail "the control is the first moment"; fi
rm stone-0003.png stone-0003.json

echo "passed"
