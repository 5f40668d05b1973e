#!/usr/bin/env bash
# Compares package and tarball of target/package for arm64 with those for this machine: same files, and same results of the program.
# The arm64 program runs under qemu-user; its shared libraries for arm64 must be installed.
set -euo pipefail
cd "$(dirname "$0")/.."
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

say() { printf -- '-- %s\n' "$1"; }
package() { ls "$PWD"/target/package/solaspect_*_"$1".deb; }
here=$(dpkg --print-architecture)

say "the package's dependencies"
control() { dpkg-deb -f "$(package "$1")" | grep -vE '^(Architecture|Installed-Size):'; }
diff <(control "$here") <(control arm64)
[ "$(dpkg-deb -f "$(package arm64)" Architecture)" = arm64 ]
apt-get install -s -qq --no-install-recommends "$(package arm64)" | grep '^Inst solaspect:arm64'

say "the same files, but for the program"
# Moves the programs to $work/ARCHITECTURE.package and .tarball.
unpack() {
    dpkg-deb -c "$(package "$1")" | awk '{ print $1, $2, $6 }' | sort > "$work/$1.list"
    dpkg-deb -R "$(package "$1")" "$work/$1"
    mkdir "$work/$1/tarball"
    tar -C "$work/$1/tarball" --strip-components 1 -xzf \
        target/package/solaspect-*-"$(dpkg-architecture -A "$1" -q DEB_TARGET_GNU_CPU)"-linux.tar.gz
    mv "$work/$1/usr/bin/solaspect" "$work/$1.package"
    mv "$work/$1/tarball/bin/solaspect" "$work/$1.tarball"
    rm "$work/$1/DEBIAN/control"
}
unpack "$here"
unpack arm64
diff "$work/$here.list" "$work/arm64.list"
diff -r "$work/$here" "$work/arm64"

say "the same answers"
solve() { "$@" solve --format jsonl tests/data/frames tests/data/kept; }
solve "$work/$here.package" > "$work/$here.jsonl"
for program in package tarball; do
    solve qemu-aarch64 "$work/arm64.$program" > "$work/$program.jsonl"
    .ci/check_same.py "$work/$here.jsonl" "$work/$program.jsonl"
done

say "a demo flight loses nothing"
qemu-aarch64 "$work/arm64.package" demo --rate 1 --duration 25s --archive "$work/archive"
