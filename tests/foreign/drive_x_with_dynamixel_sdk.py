"""Drives emulated Dynamixel X servos with the Robotis SDK, unmodified: standard table, indirect addresses, modes, limits, watchdog, baud rate.

Usage: drive_x_with_dynamixel_sdk.py DEVICE KIND
Prints one line per check; exits 1 at the first that fails.
"""

import sys
import time

from dynamixel_sdk import COMM_SUCCESS, GroupSyncRead, GroupSyncWrite, PacketHandler, PortHandler
from dynamixel_checks import ERR_ACCESS, ERR_LIMIT, GOAL, POSITION, TORQUE, baud, check, every_servo, signed

IDS = [1, 2, 3, 4, 5, 6]
# Robotis e-manual, control tables of XL330-M288, XC330-T288 and XM430-W350: model number, first byte of the indirect data, current limit.
KINDS = {"xl330": (1200, 208, 1750), "xc330": (1220, 208, 1750), "xm430": (1020, 224, 1193)}
DELAY, MODE, CURRENT_LIMIT, MAX_POSITION = 9, 11, 38, 48
VOLTAGE, TEMPERATURE, INDIRECT = 144, 146, 168


def fresh(packet, port, model, current):
    for ident in IDS:
        check(packet.ping(port, ident) == (model, COMM_SUCCESS, 0), f"ping {ident}: model {model}")
    check(packet.read1ByteTxRx(port, 1, MODE) == (3, COMM_SUCCESS, 0), "position mode from the works")
    check(packet.read1ByteTxRx(port, 1, DELAY) == (250, COMM_SUCCESS, 0), "return delay 500 us from the works")
    check(packet.read2ByteTxRx(port, 1, CURRENT_LIMIT) == (current, COMM_SUCCESS, 0), f"current limit {current}")
    volts, result, _ = packet.read2ByteTxRx(port, 1, VOLTAGE)
    check(result == COMM_SUCCESS and 50 < volts < 170, f"{volts / 10} V")
    value, result, error = packet.read2ByteTxRx(port, 1, 1064)
    check((result, error) == (COMM_SUCCESS, ERR_ACCESS), "no block of another maker")


def limits(packet, port):
    check(packet.write4ByteTxRx(port, 1, GOAL, 0xFFFFFFFF) == (COMM_SUCCESS, ERR_LIMIT), "goal -1 in position mode: limit error")
    check(packet.write4ByteTxRx(port, 1, MAX_POSITION, 3000) == (COMM_SUCCESS, 0), "a maximum position")
    check(packet.write4ByteTxRx(port, 1, GOAL, 3001) == (COMM_SUCCESS, ERR_LIMIT), "is kept")
    for ident in IDS:
        check(packet.write1ByteTxRx(port, ident, MODE, 4) == (COMM_SUCCESS, 0), f"extended position mode {ident}")
    check(packet.write4ByteTxRx(port, 1, GOAL, 0xFFFFFFFF) == (COMM_SUCCESS, 0), "there -1 is a goal")


def indirect(packet, port, data):
    for ident in IDS:
        for place, target in enumerate([POSITION, POSITION + 1, POSITION + 2, POSITION + 3, TEMPERATURE, TORQUE]):
            result = packet.write2ByteTxRx(port, ident, INDIRECT + 2 * place, target)
            check(result == (COMM_SUCCESS, 0), f"indirect address {place} of {ident}")
    read = GroupSyncRead(port, packet, data, 6)
    for ident in IDS:
        read.addParam(ident)
    for fast in (False, True):
        result = read.fastSyncRead() if fast else read.txRxPacket()
        check(result == COMM_SUCCESS, f"{'fast ' * fast}sync read of the indirect data")
        for ident in IDS:
            direct, _, _ = packet.read4ByteTxRx(port, ident, POSITION)
            got = signed(read.getData(ident, data, 4))
            check(abs(got - signed(direct)) <= 1 and 15 < read.getData(ident, data + 4, 1) < 60, f"of {ident}: {got}")
    check(packet.write1ByteTxRx(port, 2, data + 5, 1) == (COMM_SUCCESS, 0), "a write to it")
    check(packet.read1ByteTxRx(port, 2, TORQUE) == (1, COMM_SUCCESS, 0), "switches torque on")


def motion(packet, port):
    write = GroupSyncWrite(port, packet, GOAL, 4)
    read = GroupSyncRead(port, packet, POSITION, 4)
    for ident in IDS:
        packet.write1ByteTxRx(port, ident, TORQUE, 1)
        read.addParam(ident)
        # A whole turn and more, at once: these servos believe any goal.
        goal = 5000 if ident % 2 else -1000
        write.addParam(ident, list((goal & 0xFFFFFFFF).to_bytes(4, "little")))
    check(write.txPacket() == COMM_SUCCESS, "sync write of goals")
    for _ in range(400):
        reached = read.txRxPacket() == COMM_SUCCESS
        positions = [signed(read.getData(ident, POSITION, 4)) for ident in IDS]
        if reached and all(abs(p - (5000 if i % 2 else -1000)) <= 3 for i, p in zip(IDS, positions)):
            break
        time.sleep(0.05)
    check(all(abs(p - (5000 if i % 2 else -1000)) <= 3 for i, p in zip(IDS, positions)), f"positions reached: {positions}")


def restart(packet, port, data):
    before, _, _ = packet.read4ByteTxRx(port, 1, POSITION)
    check(packet.reboot(port, 1) == (COMM_SUCCESS, 0), "reboot")
    time.sleep(0.2)
    check(packet.read1ByteTxRx(port, 1, TORQUE) == (0, COMM_SUCCESS, 0), "torque is off after it")
    check(packet.read2ByteTxRx(port, 1, INDIRECT) == (data, COMM_SUCCESS, 0), "the indirect addresses are forgotten")
    after, _, _ = packet.read4ByteTxRx(port, 1, POSITION)
    check(0 <= after < 4096, f"the turns are lost, the angle is not: {before} to {after}")
    check((after - before) % 4096 in (0, 1, 2, 4094, 4095), "within the turn it is the same")
    check(packet.read1ByteTxRx(port, 1, MODE) == (4, COMM_SUCCESS, 0), "the mode is kept")
    check(packet.factoryReset(port, 1, 0x02) == (COMM_SUCCESS, 0), "factory reset")
    time.sleep(0.2)
    check(packet.read1ByteTxRx(port, 1, MODE) == (3, COMM_SUCCESS, 0), "the mode is that of the works")


def main():
    model, data, current = KINDS[sys.argv[2]]
    port = PortHandler(sys.argv[1])
    check(port.openPort(), f"open {sys.argv[1]}")
    check(port.setBaudRate(1_000_000), "1 Mbaud")
    packet = PacketHandler(2.0)
    fresh(packet, port, model, current)
    limits(packet, port)
    indirect(packet, port, data)
    motion(packet, port)
    every_servo(packet, port)
    restart(packet, port, data)
    baud(packet, port)
    port.closePort()
    print("ALL CHECKS PASSED")


main()
