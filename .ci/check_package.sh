#!/usr/bin/env bash
# Installs the Debian package of target/package on this machine, flies it, upgrades it and removes it; then unpacks the tarball and flies it
# with nothing installed. Leaves nothing behind if neither the package nor the user solaspect existed before. Needs root.
set -euo pipefail
cd "$(dirname "$0")/.."

if id solaspect >/dev/null 2>&1 || [ -e /etc/solaspect ] || [ -e /var/lib/solaspect ]; then
    echo "check_package.sh: this machine has solaspect installed, or what is left of it" >&2
    exit 1
fi
export DEBIAN_FRONTEND=noninteractive
work=$(mktemp -d)
chmod 755 "$work"
clean_up() {
    dpkg --purge solaspect >/dev/null 2>&1 || true
    userdel solaspect 2>/dev/null || true
    rm -rf "$work" /var/lib/solaspect /etc/solaspect
}
trap clean_up EXIT

say() { printf -- '-- %s\n' "$1"; }
# Minimal machines omit documentation from every package; include it here.
install_package() {
    apt-get install -y -qq --no-install-recommends -o Dpkg::Options::=--force-confold \
        -o Dpkg::Options::='--path-include=/usr/share/*' "$1"
}
as_solaspect() { (cd / && runuser -u solaspect -- "$@"); }
# The exit code says whether anything was lost, so the flight's summary is not checked.
fly() { as_solaspect solaspect fly --config /etc/solaspect/solaspect.toml --camera simulated --duration 10s; }

deb=$(ls "$PWD"/target/package/solaspect_*_"$(dpkg --print-architecture)".deb)
tarball=$(ls "$PWD"/target/package/solaspect-*-"$(uname -m)"-linux.tar.gz)

say "install"
apt-get update -qq
apt-get install -y -qq --no-install-recommends man-db bash-completion zsh fish
install_package "$deb"
solaspect --version
id -nG solaspect | grep -qw dialout
[ "$(stat -c %U /var/lib/solaspect)" = solaspect ]
[ -e /usr/lib/systemd/system/solaspect.service ]
[ ! -e /etc/systemd/system/multi-user.target.wants/solaspect.service ]
if command -v systemd-analyze >/dev/null; then systemd-analyze verify solaspect.service; fi
solaspect config check /etc/solaspect/solaspect.toml | tee "$work/check" || true
grep -q 'camera.source: expected a camera' "$work/check"
cmp calibration/heroes-pyas-f.toml /usr/share/solaspect/calibration/heroes-pyas-f.toml
[ -s /usr/share/doc/solaspect/docs/flight.md ]

say "man pages and completions"
man -w solaspect solaspect-fly solaspect-calibrate-plate
# shellcheck disable=SC2016
bash -c '
    . /usr/share/bash-completion/bash_completion
    _completion_loader solaspect || [ $? = 124 ]
    COMP_WORDS=(solaspect calibrate pl) COMP_CWORD=2
    "$(complete -p solaspect | sed "s/.*-F \([^ ]*\).*/\1/")" solaspect pl calibrate
    echo "${COMPREPLY[@]}"' | grep -qx plate
zsh -fc 'autoload -U compinit && compinit -D && [ "${_comps[solaspect]}" = _solaspect ]'
fish -c 'complete --do-complete "solaspect calibrate pl"' | grep -q '^plate'

say "fly as installed"
fly

say "upgrade: what was configured stays"
sed -i 's|^# directory = .*|directory = "/var/lib/solaspect/archive"|' /etc/solaspect/solaspect.toml
cp /etc/solaspect/solaspect.toml "$work/edited.toml"
fly
frames() { find /var/lib/solaspect/archive -name '*.fits' | sort; }
frames > "$work/frames"
[ -s "$work/frames" ]
# The next version, with another example configuration.
dpkg-deb -R "$deb" "$work/next"
version=$(dpkg-deb -f "$deb" Version)
sed -i "s/^Version: .*/Version: $version+next/" "$work/next/DEBIAN/control"
echo '# A parameter more.' >> "$work/next/etc/solaspect/solaspect.toml"
dpkg-deb --root-owner-group -Znone -b "$work/next" "$work/next.deb" >/dev/null
install_package "$work/next.deb"
dpkg-query -W -f '${Version}\n' solaspect | grep -qx "$version+next"
cmp "$work/edited.toml" /etc/solaspect/solaspect.toml
[ -e /etc/solaspect/solaspect.toml.dpkg-dist ]
fly

say "remove, and purge: data stay"
frames > "$work/frames"
dpkg --remove solaspect
[ ! -e /usr/bin/solaspect ]
cmp "$work/edited.toml" /etc/solaspect/solaspect.toml
frames | cmp - "$work/frames"
dpkg --purge solaspect
[ ! -e /etc/solaspect ]
frames | cmp - "$work/frames"

say "the tarball, with nothing around it"
mkdir "$work/empty"
tar -C "$work/empty" --strip-components 1 -xzf "$tarball"
chmod 1777 "$work/empty"
alone() { env -i "$(command -v chroot)" --userspec=nobody "$work/empty" /bin/solaspect "$@"; }
alone --version
alone fly --config /share/solaspect/solaspect.example.toml --camera simulated --archive /flown --duration 10s
alone archive check /flown
