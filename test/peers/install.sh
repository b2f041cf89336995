# Installs what the tests of this folder want beside Python's packages, where the system lets us, and
# reports in one line what is missing. Those tests are then skipped.
missing=
want() { # COMMAND PACKAGES...: Debian's packages that have the command
  command=$1; shift
  command -v "$command" > /dev/null && return
  if [ "$(id -u)" = 0 ] && command -v apt-get > /dev/null; then
    [ -n "$updated" ] || apt-get update > /dev/null 2>&1; updated=1
    DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends "$@" > /dev/null 2>&1
  fi
  command -v "$command" > /dev/null || missing="$missing $command ($*);"
}
want arm-none-eabi-gcc gcc-arm-none-eabi libnewlib-arm-none-eabi
want clang++-19 clang-19
want gdb-multiarch gdb-multiarch
want ip iproute2
want chromium chromium
want x86_64-w64-mingw32-g++ g++-mingw-w64-x86-64
want wine wine wine64
command -v cargo > /dev/null || missing="$missing cargo (rustup, or the package cargo);"
[ "$(id -u)" = 0 ] || missing="$missing root, for network namespaces;"
[ -z "$missing" ] || echo "test-peers: skipped are tests that want$missing" | sed 's/;$//'
