"""The machine behind field buses: CiA 402 drives on EtherCAT and CANopen, a converter on Modbus."""
