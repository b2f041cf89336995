# Installs what the tests of this folder want beside Python's packages, where the system lets us, and
# reports in one line what is missing. Those tests are then skipped.
missing=
add() { # PACKAGES...: Debian's
  [ "$(id -u)" = 0 ] && command -v apt-get > /dev/null || return
  [ -n "$updated" ] || apt-get update > /dev/null 2>&1; updated=1
  DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends "$@" > /dev/null 2>&1
}
want() { # COMMAND PACKAGES...: that have the command
  command=$1; shift
  command -v "$command" > /dev/null && return
  add "$@"
  command -v "$command" > /dev/null || missing="$missing $command ($*);"
}
want_file() { # FILE WHAT PACKAGES...: that have the file
  file=$1; what=$2; shift 2
  [ -e "$file" ] && return
  add "$@"
  [ -e "$file" ] || missing="$missing $what ($*);"
}
want arm-none-eabi-gcc gcc-arm-none-eabi libnewlib-arm-none-eabi
want clang++-19 clang-19
want gdb-multiarch gdb-multiarch
want ip iproute2
want chromium chromium
want x86_64-w64-mingw32-g++ g++-mingw-w64-x86-64
want wine wine wine64
# Films are drawn on the processor.
want_file "/usr/share/vulkan/icd.d/lvp_icd.$(uname -m).json" 'a Vulkan driver' mesa-vulkan-drivers
command -v cargo > /dev/null || missing="$missing cargo (rustup, or the package cargo);"
[ "$(id -u)" = 0 ] || missing="$missing root, for network namespaces;"
[ -z "$missing" ] || echo "test-peers: skipped are tests that want$missing" | sed 's/;$//'
