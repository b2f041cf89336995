#define _POSIX_C_SOURCE 200112L

#include "arrivals.h"

#include <pthread.h>
#include <stdlib.h>

#include "bytes.h"

typedef struct arrival {
  ros_arrivals* of;
  int64_t topic;
} arrival;

struct ros_arrivals {
  ros_topic* topic;
  int64_t topics;
  void* guard;
  arrival* each;         /* what the middleware hands back, per topic */
  pthread_mutex_t mutex; /* guards `open` and `missed`, and all below while they are open */
  int open, missed;
  ros_arrived arrived;
  rcl_bytes newest;
};

/* Take the messages of a topic; 0: one was left to Python. */
static int take_from(ros_arrivals* own, int64_t k) {
  ros_topic* topic = own->topic + k;
  rcl_bytes* bytes = &own->newest;
  while (ros_take_bytes(topic->subscription, bytes, &own->arrived.message)) {
    if (ros_hand_over(topic, &own->arrived.message) == ROS_FOR_PYTHON) {
      own->arrived.left = k;
      return 0;
    }
    ++own->arrived.handled;
  }
  return 1;
}

/* A message has come. The middleware calls it with its own lock of the subscription held. */
static void note_arrival(const void* data, size_t number) {
  const arrival* signal = data;
  ros_arrivals* own = signal->of;
  (void)number;
  pthread_mutex_lock(&own->mutex);
  if (!own->open) {
    own->missed = 1;
  } else if (!take_from(own, signal->topic)) {
    own->open = 0;
    if (rcl_trigger_guard_condition(own->guard) != RCL_RET_OK) rcutils_reset_error();
  }
  pthread_mutex_unlock(&own->mutex);
}

static void listen_no_more(ros_arrivals* own, int64_t topics) {
  for (int64_t k = 0; k < topics; ++k)
    if (rcl_subscription_set_on_new_message_callback(own->topic[k].subscription, NULL, NULL) !=
        RCL_RET_OK)
      rcutils_reset_error(); /* its context was shut down */
}

ros_arrivals* ros_arrivals_new(ros_topic* topic, int64_t topics, void* guard) {
  ros_arrivals* own = calloc(1, sizeof *own);
  arrival* each = calloc((size_t)topics, sizeof *each);
  if (own && each) {
    *own = (ros_arrivals){.topic = topic, .topics = topics, .guard = guard, .each = each};
    own->arrived.left = -1;
    own->newest = ros_no_bytes();
    pthread_mutex_init(&own->mutex, NULL);
    int64_t k = 0;
    for (; k < topics; ++k) {
      each[k] = (arrival){own, k};
      const void* subscription = topic[k].subscription;
      if (rcl_subscription_set_on_new_message_callback(subscription, note_arrival, each + k) !=
          RCL_RET_OK)
        break;
    }
    if (k == topics) return own;
    rcutils_reset_error();
    listen_no_more(own, k);
    pthread_mutex_destroy(&own->mutex);
  }
  free(each);
  free(own);
  return NULL;
}

void ros_arrivals_delete(ros_arrivals* own) {
  if (!own) return;
  listen_no_more(own, own->topics);
  pthread_mutex_destroy(&own->mutex);
  free(own->newest.buffer);
  free(own->each);
  free(own);
}

int ros_arrivals_open(ros_arrivals* own) {
  own->arrived.left = -1;
  for (int open = 0; !open;) {
    pthread_mutex_lock(&own->mutex);
    own->missed = 0;
    pthread_mutex_unlock(&own->mutex);
    /* Without the mutex: taking needs the lock that is held where a message arrives. */
    for (int64_t k = 0; k < own->topics; ++k)
      if (!take_from(own, k)) return 0;
    pthread_mutex_lock(&own->mutex);
    open = own->open = !own->missed;
    pthread_mutex_unlock(&own->mutex);
  }
  return 1;
}

void ros_arrivals_close(ros_arrivals* own, ros_arrived* out) {
  pthread_mutex_lock(&own->mutex);
  own->open = 0;
  *out = own->arrived;
  pthread_mutex_unlock(&own->mutex);
}
