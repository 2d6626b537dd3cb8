#!/usr/bin/env bash
# Makes a Vulkan driver available without touching the system, and prints the environment it needs:
#
#     eval "$(scripts/vulkan.sh)"
#
# Prints nothing where the machine has a usable driver: a graphics card with its driver, or a Mesa
# software driver that is new enough. Otherwise it downloads Mesa's software driver, the Vulkan
# loader and what they need from the distribution's own archive, and unpacks them below
# .cache/vulkan. Works on Debian 12 (from its backports), Debian 13 and Ubuntu 24.04 or newer, as
# root or not; needs only apt and dpkg-deb. `--force` unpacks a private driver in any case.
set -euo pipefail

# Before 24, Mesa's software driver lacks features that SAPIEN needs and runs compute many times slower.
readonly MINIMUM_MESA_MAJOR=24

cache="$(cd "$(dirname "$0")/.." && pwd)/.cache/vulkan"
readonly cache

say() { echo "vulkan: $*" >&2; }
die() {
    say "$*"
    exit 1
}

has_loader() { { ldconfig -p || /sbin/ldconfig -p; } 2>/dev/null | grep -q 'libvulkan\.so\.1'; }

has_hardware_driver() {
    compgen -G '/dev/dri/renderD*' >/dev/null || [ -e /dev/nvidia0 ] || return 1
    compgen -G '/usr/share/vulkan/icd.d/*.json' >/dev/null ||
        compgen -G '/etc/vulkan/icd.d/*.json' >/dev/null
}

has_new_software_driver() {
    local version
    version="$(dpkg-query -W -f '${Version}' mesa-vulkan-drivers 2>/dev/null)" || return 1
    dpkg --compare-versions "$version" ge "$MINIMUM_MESA_MAJOR"
}

# apt with its own sources, lists and archives, so that neither the system's state nor root is needed.
private_apt() {
    apt-get -qq \
        -o Dir::Etc::SourceList="$cache/apt/sources.list" -o Dir::Etc::SourceParts=- \
        -o Dir::State="$cache/apt/state" -o Dir::State::status=/var/lib/dpkg/status \
        -o Dir::Cache="$cache/apt/cache" -o Debug::NoLocking=true \
        -o APT::Sandbox::User="$(id -un)" -o Acquire::Retries=3 -o Acquire::Languages=none \
        "$@" >&2
}

# The distribution's entries of the system's own sources, as one-line entries; plus backports on request.
write_sources() {
    local codename="$1" backports="$2" targets
    targets="$(apt-get indextargets --no-release-info \
        --format '$(REPO_URI) $(RELEASE) $(COMPONENT)' 'Created-By: Packages' | sort -u)"
    {
        awk -v name="$codename" '$2 ~ "^" name { print "deb", $1, $2, $3 }' <<<"$targets"
        if [ "$backports" = yes ]; then
            awk -v name="$codename" '$2 == name && $3 == "main" { print "deb", $1, name "-backports main" }' <<<"$targets"
        fi
    } | sort -u >"$cache/apt/sources.list"
    grep -q . "$cache/apt/sources.list" || die "found no archive of $codename in the system's apt sources"
}

unpack_driver() {
    local codename backports=no release=()
    command -v apt-get dpkg-deb >/dev/null || die "needs apt-get and dpkg-deb; install a Vulkan driver by hand"
    # shellcheck disable=SC1091
    codename="$(. /etc/os-release && echo "${VERSION_CODENAME:-}")"
    case "$codename" in
    bookworm) backports=yes release=(-t bookworm-backports) ;;
    buster | bullseye | focal | jammy)
        die "the Mesa of $codename is too old; install a Vulkan driver of Mesa $MINIMUM_MESA_MAJOR or newer"
        ;;
    esac
    say "no usable Vulkan driver; unpacking Mesa's software driver into .cache/vulkan"
    rm -rf "$cache"
    mkdir -p "$cache/apt/state/lists/partial" "$cache/apt/cache/archives/partial" "$cache/unpacked"
    write_sources "$codename" "$backports"
    private_apt update
    private_apt "${release[@]}" --yes --download-only --no-install-recommends --reinstall \
        install mesa-vulkan-drivers libvulkan1
    local archive
    for archive in "$cache"/apt/cache/archives/*.deb; do
        dpkg-deb -x "$archive" "$cache/unpacked"
    done
    rm -rf "$cache/apt"
}

# Writes the driver's description and the environment that points at it.
write_environment() {
    local library folder
    library="$(find "$cache/unpacked/usr/lib" -name libvulkan_lvp.so -print -quit)"
    [ -n "$library" ] || die "the downloaded packages hold no libvulkan_lvp.so"
    folder="$(dirname "$library")"
    if LD_LIBRARY_PATH="$folder" ldd "$library" | grep 'not found' >&2; then
        die "the downloaded driver lacks the libraries above"
    fi
    printf '{"file_format_version": "1.0.1", "ICD": {"library_path": "%s", "api_version": "1.3.0"}}\n' \
        "$library" >"$cache/lvp_icd.json"
    {
        echo "export VK_DRIVER_FILES='$cache/lvp_icd.json'"
        echo "export VK_ICD_FILENAMES='$cache/lvp_icd.json'"
        # Mesa keeps one compiled copy of each pipeline here instead of in the user's home.
        echo "export MESA_SHADER_CACHE_DIR='$cache/shaders'"
        echo "export LD_LIBRARY_PATH='$folder'\${LD_LIBRARY_PATH:+:\$LD_LIBRARY_PATH}"
    } >"$cache/environment.partial"
    mv "$cache/environment.partial" "$cache/environment"
}

if [ "${1:-}" != --force ]; then
    if [ -n "${VK_DRIVER_FILES:-}${VK_ICD_FILENAMES:-}" ]; then exit 0; fi
    if has_loader && { has_hardware_driver || has_new_software_driver; }; then exit 0; fi
fi
if ! grep -qF "'$cache/lvp_icd.json'" "$cache/environment" 2>/dev/null; then
    unpack_driver
    write_environment
fi
cat "$cache/environment"
