// The functions of ethercat.h. Stands behind drives.hpp in the unit of this bus.
#include "ethercat.h"

#include "port.hpp"
#include "segment.hpp"

struct ethercat_segment : ethercat::Segment {
  using Segment::Segment;
  ethercat::Port port{*this};
};

#pragma GCC visibility push(default)

ethercat_segment* ethercat_new(const ethercat_options* options) {
  const bool sound = options && options->size >= sizeof *options && options->all &&
                     drives_count(options->all) > 0 && options->period > 0;
  return sound ? new ethercat_segment(*options) : nullptr;
}
void ethercat_delete(ethercat_segment* segment) { delete segment; }
int64_t ethercat_frame(ethercat_segment* segment, uint8_t* frame, int64_t size, int64_t now) {
  if (!segment || !frame || size < 0) return 0;
  const std::size_t back = segment->pass({frame, static_cast<std::size_t>(size)}, now);
  segment->finish_exchange();
  return static_cast<int64_t>(back);
}
int ethercat_period(ethercat_segment* segment, int64_t now) {
  return segment ? segment->period(now) : int{ARM_REFUSED};
}
void ethercat_get_figures(const ethercat_segment* segment, ethercat_figures* out) {
  if (segment && out) *out = segment->figures();
}
const uint8_t* ethercat_memory(const ethercat_segment* segment, int32_t slave) {
  if (!segment || slave < 0 || slave >= segment->count()) return nullptr;
  return segment->slave(static_cast<std::size_t>(slave)).contents().at(0);
}
int ethercat_open(const char* interface) {
  return interface ? ethercat::open_interface(interface) : -EINVAL;
}
int ethercat_serve(ethercat_segment* segment, int descriptor, int64_t duration) {
  return segment ? segment->port.serve(descriptor, duration) : -EINVAL;
}

#pragma GCC visibility pop
