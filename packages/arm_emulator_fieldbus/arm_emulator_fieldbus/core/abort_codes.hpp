// Why an access is refused, as servers of service data objects answer it (CiA 301, table 22).
#pragma once

#include <cstdint>

namespace fieldbus {

namespace abort_code {
inline constexpr std::uint32_t none = 0;
inline constexpr std::uint32_t toggle = 0x05030000;
inline constexpr std::uint32_t command = 0x05040001;
inline constexpr std::uint32_t block_size = 0x05040002;
inline constexpr std::uint32_t sequence = 0x05040003;
inline constexpr std::uint32_t checksum = 0x05040004;
inline constexpr std::uint32_t memory = 0x05040005;
inline constexpr std::uint32_t unsupported = 0x06010000;
inline constexpr std::uint32_t write_only = 0x06010001;
inline constexpr std::uint32_t read_only = 0x06010002;
inline constexpr std::uint32_t sub0_not_zero = 0x06010003;  // ETG.1000.6: mapping, sub 0 is not 0
inline constexpr std::uint32_t no_object = 0x06020000;
inline constexpr std::uint32_t not_mappable = 0x06040041;
inline constexpr std::uint32_t pdo_too_long = 0x06040042;
inline constexpr std::uint32_t incompatible = 0x06040043;
inline constexpr std::uint32_t wrong_length = 0x06070010;
inline constexpr std::uint32_t too_long = 0x06070012;
inline constexpr std::uint32_t too_short = 0x06070013;
inline constexpr std::uint32_t no_sub = 0x06090011;
inline constexpr std::uint32_t out_of_range = 0x06090030;
inline constexpr std::uint32_t too_high = 0x06090031;
inline constexpr std::uint32_t too_low = 0x06090032;
inline constexpr std::uint32_t general = 0x08000000;
inline constexpr std::uint32_t cannot_store = 0x08000020;
inline constexpr std::uint32_t state = 0x08000022;
}  // namespace abort_code

}  // namespace fieldbus
