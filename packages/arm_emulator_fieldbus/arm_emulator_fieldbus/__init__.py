"""Drives of CiA 402 on EtherCAT and CANopen, and a Modbus converter."""
