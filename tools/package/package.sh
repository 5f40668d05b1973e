#!/usr/bin/env bash
# Makes the Debian package and the tarball in target/package, for each architecture given by its Debian name (`amd64`, `arm64`), or for this
# machine's. Needs dpkg-dev, `cargo install cargo-deb --locked`, and libaravis-dev and libusb-1.0-0-dev for GigE Vision cameras, which the
# Debian package supports. docs/flight.md lists what other architectures need.
set -euo pipefail
cd "$(dirname "$0")/../.."
out=target/package
here=$(dpkg --print-architecture)
version=$(cargo pkgid | sed 's/.*[#@]//')
(($#)) || set -- "$here"

# Makes cargo compile for another architecture than this machine's.
cross() {
    local architecture=$1 gnu triple variable file
    gnu=$(dpkg-architecture -A "$architecture" -q DEB_TARGET_GNU_TYPE)
    triple=${gnu/-linux/-unknown-linux}
    variable=${triple//-/_}
    export CARGO_BUILD_TARGET=$triple
    export "CARGO_TARGET_${variable^^}_LINKER=$gnu-gcc"
    export "PKG_CONFIG_$variable=$gnu-pkg-config"
    # Debian's compiler, if the usual one has no standard library for this architecture.
    compgen -G "$(rustc --print target-libdir --target "$triple")/libstd-*" >/dev/null || export RUSTC=/usr/bin/rustc
    # cfitsio is compiled in its source folder, where make would reuse objects of another architecture, so each architecture has its own sources.
    local home=${CARGO_HOME:-$HOME/.cargo}
    export CARGO_HOME=$PWD/target/cargo-$architecture
    mkdir -p "$CARGO_HOME/registry"
    for file in config.toml registry/cache registry/index; do
        if [ -e "$home/$file" ]; then ln -sfn "$home/$file" "$CARGO_HOME/$file"; fi
    done
}

package() (
    architecture=$1
    if [ "$architecture" != "$here" ]; then cross "$architecture"; fi
    cargo deb --output "$out/"

    # The tarball's program is linked statically: it runs on any Linux, but without GigE Vision cameras, because Aravis is a shared library.
    cargo rustc --release --bin solaspect -- -C target-feature=+crt-static
    name=solaspect-$version-$(dpkg-architecture -A "$architecture" -q DEB_TARGET_GNU_CPU)-linux
    root=$out/$name
    install -D -t "$root/bin" "target/${CARGO_BUILD_TARGET:-}/release/solaspect"
    install -D -m 644 -t "$root/share/man/man1" target/pages/man/*
    install -D -m 644 target/pages/completions/solaspect.bash "$root/share/bash-completion/completions/solaspect"
    install -D -m 644 -t "$root/share/zsh/site-functions" target/pages/completions/_solaspect
    install -D -m 644 -t "$root/share/fish/vendor_completions.d" target/pages/completions/solaspect.fish
    install -D -m 644 -t "$root/share/solaspect/calibration" calibration/*.toml
    install -D -m 644 -t "$root/share/solaspect" docs/solaspect.example.toml tools/systemd/solaspect.service
    cp -r README.md CHANGELOG.md LICENSE-* docs "$root"
    tar -C "$out" --owner=0 --group=0 --sort=name -czf "$out/$name.tar.gz" "$name"
    rm -r "$root"
)

rm -rf "$out" target/pages
mkdir -p "$out"
cargo run --release -p pages -- target/pages
for architecture; do package "$architecture"; done
ls -l "$out"
