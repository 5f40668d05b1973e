#!/usr/bin/env bash
# Makes the Debian package and the tarball, in target/package. Needs `cargo install cargo-deb --locked`, and for GigE Vision cameras, which
# the Debian package can fly, libaravis-dev and libusb-1.0-0-dev.
set -euo pipefail
cd "$(dirname "$0")/../.."
out=target/package
rm -rf "$out" target/pages
mkdir -p "$out"

cargo run --release -p pages -- target/pages
cargo deb --output "$out/"

# The tarball's program is linked statically: it runs on any Linux, but without GigE Vision cameras, for Aravis is a shared library.
cargo rustc --release --bin solaspect -- -C target-feature=+crt-static
version=$(target/release/solaspect --version | cut -d' ' -f2)
name=solaspect-$version-$(uname -m)-linux
root=$out/$name
install -D -t "$root/bin" target/release/solaspect
install -D -m 644 -t "$root/share/man/man1" target/pages/man/*
install -D -m 644 target/pages/completions/solaspect.bash "$root/share/bash-completion/completions/solaspect"
install -D -m 644 -t "$root/share/zsh/site-functions" target/pages/completions/_solaspect
install -D -m 644 -t "$root/share/fish/vendor_completions.d" target/pages/completions/solaspect.fish
install -D -m 644 -t "$root/share/solaspect/calibration" calibration/*.toml
install -D -m 644 -t "$root/share/solaspect" docs/solaspect.example.toml tools/systemd/solaspect.service
cp -r README.md CHANGELOG.md LICENSE-* docs "$root"
tar -C "$out" --owner=0 --group=0 --sort=name -czf "$out/$name.tar.gz" "$name"
rm -r "$root"
ls -l "$out"
