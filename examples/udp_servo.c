// A servo of one's own, in C, behind a socket.
//
//   arm_emulator udp three_axis --header > udp_three_axis.h
//   cc udp_servo.c -o udp_servo
//   arm_emulator udp three_axis &  ./udp_servo
#include <arpa/inet.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/socket.h>
#include <sys/time.h>

#include "udp_three_axis.h"

static const double target[ARM_UDP_JOINTS] = {9000, 1000, 14000};  // counts
static const double gain = 0.004;                                  // V per count
static const double damping = 0.04;                                // V per count and period

// Send a command until the reply is there: UDP may lose either of them.
static arm_udp_measurement exchange(int socket, arm_udp_command command) {
  arm_udp_measurement measured;
  command.layout = ARM_UDP_LAYOUT, command.control = ARM_UDP_POWER;
  for (int k = 0; k < 100; ++k) {
    send(socket, &command, sizeof command, 0);
    if (recv(socket, &measured, sizeof measured, 0) == sizeof measured) return measured;
  }
  exit(fprintf(stderr, "no reply\n"));
}

int main(int count, char** words) {
  const int port = count > 1 ? atoi(words[1]) : ARM_UDP_PORT;
  const struct sockaddr_in there = {
      .sin_family = AF_INET, .sin_port = htons(port), .sin_addr = {htonl(INADDR_LOOPBACK)}};
  const struct timeval patience = {.tv_usec = 100000};
  const int s = socket(AF_INET, SOCK_DGRAM, 0);
  setsockopt(s, SOL_SOCKET, SO_RCVTIMEO, &patience, sizeof patience);
  connect(s, (const struct sockaddr*)&there, sizeof there);

  arm_udp_measurement now = exchange(s, (arm_udp_command){.tick = ARM_UDP_GREETING}), before = now;
  while (now.tick < 2000) {
    arm_udp_command command = {.tick = now.tick};
    for (int j = 0; j < ARM_UDP_JOINTS; ++j) {
      const double error = target[j] - now.encoder_counts[j];
      const double speed = now.encoder_counts[j] - before.encoder_counts[j];
      command.command[j] = gain * error - damping * speed;
    }
    before = now;
    now = exchange(s, command);
  }
  for (int j = 0; j < ARM_UDP_JOINTS; ++j)
    printf("%s %lld\n", arm_udp_joint_names[j], (long long)now.encoder_counts[j]);
}
