/* Functions of rcl that are called, declared with opaque pointers.
 *
 * Versions: rcl 9.2 (Jazzy). Reason: no headers of ROS are there where it is compiled. Test:
 * test/ros/test_hot_path.py, `test_rcl_is_called_as_its_headers_declare`.
 */
#ifndef RCL_CALLS_H
#define RCL_CALLS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum { RCL_RET_OK = 0, RCL_RET_SUBSCRIPTION_TAKE_FAILED = 401 };

typedef struct rcl_allocator {
  void* (*allocate)(size_t size, void* state);
  void (*deallocate)(void* pointer, void* state);
  void* (*reallocate)(void* pointer, size_t size, void* state);
  void* (*zero_allocate)(size_t number, size_t size, void* state);
  void* state;
} rcl_allocator;

typedef struct rcl_bytes { /* rcl_serialized_message_t */
  uint8_t* buffer;
  size_t buffer_length, buffer_capacity;
  rcl_allocator allocator;
} rcl_bytes;

typedef struct rcl_gid { /* rmw_gid_t */
  const char* implementation_identifier;
  uint8_t data[16];
} rcl_gid;

typedef struct rcl_message_info { /* rmw_message_info_t */
  int64_t source_timestamp, received_timestamp;
  uint64_t publication_sequence_number, reception_sequence_number;
  rcl_gid publisher_gid;
  bool from_intra_process;
} rcl_message_info;

int32_t rcl_take_serialized_message(const void* subscription, rcl_bytes* message,
                                    rcl_message_info* info, void* allocation);
int32_t rcl_publish_serialized_message(const void* publisher, const rcl_bytes* message,
                                       void* allocation);
int32_t rcl_subscription_set_on_new_message_callback(const void* subscription,
                                                     void (*came)(const void* data, size_t number),
                                                     const void* data);
int32_t rcl_trigger_guard_condition(void* guard);
void rcutils_reset_error(void);

#endif
