#!/bin/bash
# Processor time of a frame by Stellarium and by skybench, one after the other on this machine.
#
#   scripts/compare_with_stellarium.sh [FRAMES]
#
# Both draw wide fields around a zenith: Stellarium 1024 x 768 pixels (its window where no window manager runs), skybench
# 1080 x 720, 1 % fewer. Stellarium (Debian's package, in a virtual X server, drawn by the processor) saves 8-bit pictures without noise or truth; skybench makes raw 16-bit images with both, all its
# catalogue, components of the sky and stray light. Stellarium's start is left out: the time of FRAMES pictures more.
# Where the programs are missing, `sudo apt-get install stellarium xvfb` is run; SKYBENCH names another skybench.
set -euo pipefail

frames=${1:-30}
skybench=${SKYBENCH:-skybench}
few=2

missing=()
command -v stellarium >/dev/null || missing+=(stellarium)
command -v xvfb-run >/dev/null || missing+=(xvfb)
if ((${#missing[@]})); then
    as_root=()
    [[ $EUID -eq 0 ]] || as_root=(sudo)
    "${as_root[@]}" apt-get install --yes --no-install-recommends "${missing[@]}"
fi
command -v "$skybench" >/dev/null || { echo "$skybench: not found; set SKYBENCH to skybench's path" >&2; exit 2; }

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

# Write a script that saves so many pictures.
pictures_script() {
    cat >"$work/draw.ssc" <<END
core.setObserverLocation(4.36, 52.0, 0, 0.1, "here", "Earth");
core.setGuiVisible(false);
LandscapeMgr.setFlagLandscape(false);
core.setProjectionMode("ProjectionPerspective");
core.setDate("2020-01-15T20:00:00", "utc");
core.moveToAltAzi("89.9", "180", 1);
StelMovementMgr.zoomTo(98.2, 1);
core.wait(4);
for (var i = 0; i < $1; i++) {
    core.setDate("2020-01-15T20:" + (10 + i % 50) + ":" + (10 + Math.floor(i / 50) % 50), "utc");
    core.wait(0.01);
    core.screenshot("sky-", false, "$work/pictures", false);
}
core.quitStellarium();
END
}

# Processor seconds, user and system, of Stellarium with so many pictures.
seconds_of_stellarium() {
    local TIMEFORMAT='%U %S' used
    rm -rf "$work/pictures" "$work/home"
    mkdir -p "$work/pictures" "$work/home"
    pictures_script "$1"
    used=$( { time HOME="$work/home" LIBGL_ALWAYS_SOFTWARE=1 timeout 300 xvfb-run --auto-servernum \
        --server-args="-screen 0 1280x1024x24" stellarium --full-screen=no --startup-script "$work/draw.ssc" \
        >"$work/stellarium.log" 2>&1; } 2>&1 )
    local saved
    saved=$(find "$work/pictures" -name '*.png' | wc -l)
    if ((saved != $1)); then
        tail -5 "$work/stellarium.log" >&2
        echo "Stellarium saved $saved of $1 pictures" >&2
        return 1
    fi
    awk '{ print $1 + $2 }' <<<"$used"
}

first=$(seconds_of_stellarium "$few")
more=$(seconds_of_stellarium "$((few + frames))")
[[ -z ${KEEP_PICTURE:-} ]] || cp "$(find "$work/pictures" -name '*.png' | sort | tail -1)" "$KEEP_PICTURE"
"$skybench" speed --frames "$frames" --pairs 1 --json >"$work/skybench.json"
python3 - "$first" "$more" "$frames" "$work/skybench.json" <<'END'
import json
import sys

first, more, frames = float(sys.argv[1]), float(sys.argv[2]), int(sys.argv[3])
with open(sys.argv[4], encoding="utf-8") as file:
    report = json.load(file)
theirs, ours, load = (more - first) / frames, report["frame_s"], report["load"]
print(f"Stellarium: {1000 * theirs:.0f} ms of processor time a picture, 8 bit, saved as PNG")
print(f"skybench:   {1000 * ours:.0f} ms of processor time a frame, 16 bit, with noise and truth")
print(f"ratio:      {theirs / ours:.2f}")
print(f"machine:    {load['cores']} cores, load average {load['before']:.1f} before and {load['after']:.1f} after skybench's part")
END
