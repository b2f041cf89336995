// Frames of a network interface, by a raw socket.
#pragma once

#include <arpa/inet.h>
#include <linux/ethtool.h>
#include <linux/if_packet.h>
#include <linux/sockios.h>
#include <net/ethernet.h>
#include <net/if.h>
#include <net/if_arp.h>
#include <poll.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>

#include "segment.hpp"

namespace ethercat {

constexpr std::uint16_t kEtherType = 0x88a4;

// A descriptor, or -errno.
inline int open_interface(const char* name) {
  const int descriptor =
      socket(AF_PACKET, SOCK_RAW | SOCK_NONBLOCK | SOCK_CLOEXEC, htons(kEtherType));
  if (descriptor < 0) return -errno;
  const auto no = [descriptor] {
    const int error = errno;
    close(descriptor);
    return -error;
  };
  sockaddr_ll address = {};
  address.sll_family = AF_PACKET;
  address.sll_protocol = htons(kEtherType);
  address.sll_ifindex = static_cast<int>(if_nametoindex(name));
  if (address.sll_ifindex == 0) return no();
  ifreq request = {};
  std::strncpy(request.ifr_name, name, sizeof request.ifr_name - 1);
  if (ioctl(descriptor, SIOCGIFHWADDR, &request) < 0) return no();
  if (request.ifr_hwaddr.sa_family != ARPHRD_ETHER) {  // on lo, our replies would come back to us
    close(descriptor);
    return -EPFNOSUPPORT;
  }
  const int enable = 1;
  setsockopt(descriptor, SOL_PACKET, PACKET_IGNORE_OUTGOING, &enable, sizeof enable);
  packet_mreq all = {};
  all.mr_ifindex = address.sll_ifindex;
  all.mr_type = PACKET_MR_PROMISC;  // masters send to addresses of their own choice
  setsockopt(descriptor, SOL_PACKET, PACKET_ADD_MEMBERSHIP, &all, sizeof all);
  if (bind(descriptor, reinterpret_cast<const sockaddr*>(&address), sizeof address) < 0)
    return no();
  return descriptor;
}

inline std::int64_t read_clock() {
  timespec t;
  clock_gettime(CLOCK_MONOTONIC, &t);
  return t.tv_sec * 1'000'000'000LL + t.tv_nsec;
}

// Carries frames between an interface and a segment.
class Port {
 public:
  explicit Port(Segment& segment) : segment_(segment) {}

  int serve(int descriptor, std::int64_t duration) {
    const std::int64_t end = read_clock() + duration;
    if (due_ == 0) due_ = read_clock() + segment_.period_ns();
    for (std::int64_t now; (now = read_clock()) < end;) {
      if (segment_.diverged()) return 0;
      const bool paced = !segment_.lockstep() || (!up_ && segment_.exchanges());
      if (!paced) due_ = now + segment_.period_ns();
      if (paced && now >= due_) {
        const std::int64_t late = (now - due_) / segment_.period_ns();
        segment_.count_late(late);
        due_ += (late + 1) * segment_.period_ns();
        segment_.period(now);
        continue;
      }
      pollfd wait = {descriptor, POLLIN, 0};
      const std::int64_t left = std::min(end, paced ? due_ : now + 20'000'000) - now;
      const timespec limit = {left / 1'000'000'000, left % 1'000'000'000};
      const int ready = ppoll(&wait, 1, &limit, nullptr);
      if (ready < 0) return errno == EINTR ? 0 : -errno;
      if (ready == 0 && !segment_.lockstep()) continue;  // a period is over
      if (ready == 0 || wait.revents & (POLLERR | POLLHUP)) {
        clear_error(descriptor);
        const int link = has_link(descriptor);
        if (link < 0) return link;
        up_ = link > 0;
        continue;
      }
      up_ = true;
      if (const int result = receive(descriptor); result < 0) return result;
    }
    return 0;
  }

 private:
  int receive(int descriptor) {
    const ssize_t size = recv(descriptor, buffer_, sizeof buffer_, MSG_TRUNC);
    if (size < 0) return errno == EAGAIN || errno == EINTR || errno == ENETDOWN ? 0 : -errno;
    const auto length = std::min(static_cast<std::size_t>(size), sizeof buffer_);
    const std::size_t back = segment_.pass({buffer_, length}, read_clock());
    if (back > 0 && send(descriptor, buffer_, back, 0) < 0 && errno != ENETDOWN &&
        errno != EAGAIN && errno != ENOBUFS && errno != EINTR && errno != EMSGSIZE)
      return -errno;
    segment_.finish_exchange();  // the frame is on its way back meanwhile
    return 0;
  }

  static void clear_error(int descriptor) {
    int error = 0;
    socklen_t size = sizeof error;
    getsockopt(descriptor, SOL_SOCKET, SO_ERROR, &error, &size);
  }
  // 1: the interface has a link, 0: it has none, -errno: there is no interface any more. The flag
  // IFF_RUNNING follows a cable by up to a second, and misses one that is soon plugged in again.
  static int has_link(int descriptor) {
    sockaddr_ll address = {};
    socklen_t size = sizeof address;
    ifreq request = {};
    if (getsockname(descriptor, reinterpret_cast<sockaddr*>(&address), &size) < 0) return -errno;
    if (!if_indextoname(static_cast<unsigned>(address.sll_ifindex), request.ifr_name))
      return -ENODEV;
    if (ioctl(descriptor, SIOCGIFFLAGS, &request) < 0) return -errno;
    const auto flags = static_cast<std::uint16_t>(request.ifr_flags);
    ethtool_value link = {ETHTOOL_GLINK, 0};
    request.ifr_data = reinterpret_cast<char*>(&link);
    if (ioctl(descriptor, SIOCETHTOOL, &request) == 0) return flags & IFF_UP && link.data != 0;
    return flags & IFF_UP && flags & IFF_RUNNING;
  }

  Segment& segment_;
  std::int64_t due_ = 0;  // when the next servo period by the clock ends, ns
  bool up_ = true;
  std::uint8_t buffer_[2048];
};

}  // namespace ethercat
