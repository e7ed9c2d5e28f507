"""Checks that the Robotis SDK makes of any emulated servo: bulk, registered writes, answer levels, watchdog, baud rate."""

import sys
import time

from dynamixel_sdk import COMM_RX_TIMEOUT, COMM_SUCCESS, GroupBulkRead, GroupBulkWrite, port_handler

# The adapter's latency in the SDK's time-outs [ms]: generous, so that a busy machine fails no check.
port_handler.LATENCY_TIMER = 250

# Robotis e-manual, control table of the X series; our packed drivers have the same addresses.
BAUD, TORQUE, LED, LEVEL, REGISTERED, HARDWARE_ERROR, P_GAIN = 8, 64, 65, 68, 69, 70, 84
WATCHDOG, GOAL, POSITION = 98, 116, 132
ERR_LIMIT, ERR_ACCESS = 6, 7


def check(condition, what):
    print(("ok " if condition else "FAILED ") + what, flush=True)
    if not condition:
        sys.exit(1)


def signed(value, bits=32):
    return value - (1 << bits) if value >= 1 << (bits - 1) else value


def bulk(packet, port):
    write = GroupBulkWrite(port, packet)
    write.addParam(1, P_GAIN, 2, [0x2C, 0x01])
    write.addParam(3, LED, 1, [1])
    check(write.txPacket() == COMM_SUCCESS, "bulk write")
    check(packet.read2ByteTxRx(port, 1, P_GAIN) == (300, COMM_SUCCESS, 0), "changes one register of one driver")
    check(packet.read1ByteTxRx(port, 3, LED) == (1, COMM_SUCCESS, 0), "and another of another")
    for fast in (False, True):
        read = GroupBulkRead(port, packet)
        read.addParam(3, LED, 1)
        read.addParam(1, P_GAIN, 2)
        read.addParam(6, POSITION, 4)
        result = read.fastBulkRead() if fast else read.txRxPacket()
        check(result == COMM_SUCCESS, "fast bulk read" if fast else "bulk read")
        got = (read.getData(3, LED, 1), read.getData(1, P_GAIN, 2))
        check(got == (1, 300) and read.isAvailable(6, POSITION, 4), f"reads {got}")


def registered(packet, port):
    check(packet.read1ByteTxRx(port, 2, REGISTERED) == (0, COMM_SUCCESS, 0), "nothing is registered")
    check(packet.regWriteTxRx(port, 2, LED, 1, [1]) == (COMM_SUCCESS, 0), "reg write")
    check(packet.read1ByteTxRx(port, 2, REGISTERED) == (1, COMM_SUCCESS, 0), "register 69 says so")
    check(packet.read1ByteTxRx(port, 2, LED) == (0, COMM_SUCCESS, 0), "and nothing happens yet")
    check(packet.action(port, 0xFE) == COMM_SUCCESS, "action")
    check(packet.read1ByteTxRx(port, 2, LED) == (1, COMM_SUCCESS, 0), "now it does")


def levels(packet, port):
    check(packet.write1ByteTxRx(port, 5, LEVEL, 1) == (COMM_SUCCESS, 0), "status return level 1 at its next packet")
    check(packet.write1ByteTxRx(port, 5, LED, 1)[0] == COMM_RX_TIMEOUT, "then a write is not answered")
    check(packet.read1ByteTxRx(port, 5, LED) == (1, COMM_SUCCESS, 0), "a read is")
    packet.write1ByteTxOnly(port, 5, LEVEL, 0)
    check(packet.read1ByteTxRx(port, 5, LED)[1] == COMM_RX_TIMEOUT, "level 0: nor a read")
    check(packet.ping(port, 5)[1] == COMM_SUCCESS, "a ping always")
    packet.write1ByteTxOnly(port, 5, LEVEL, 2)


def watchdog(packet, port):
    check(packet.write1ByteTxRx(port, 4, WATCHDOG, 5) == (COMM_SUCCESS, 0), "watchdog of 100 ms")
    time.sleep(0.4)
    check(packet.read1ByteTxRx(port, 4, WATCHDOG) == (255, COMM_SUCCESS, 0), "tripped reads -1")
    check(packet.write4ByteTxRx(port, 4, GOAL, 0) == (COMM_SUCCESS, ERR_ACCESS), "goals are refused")
    check(packet.write1ByteTxRx(port, 4, WATCHDOG, 0) == (COMM_SUCCESS, 0), "cleared")
    check(packet.read1ByteTxRx(port, 4, HARDWARE_ERROR) == (0, COMM_SUCCESS, 0), "no hardware error")


def baud(packet, port):
    check(packet.write1ByteTxRx(port, 6, TORQUE, 0) == (COMM_SUCCESS, 0), "torque off")
    check(packet.write1ByteTxRx(port, 6, BAUD, 2)[0] in (COMM_SUCCESS, COMM_RX_TIMEOUT), "115200 baud for one")
    check(packet.ping(port, 6)[1] == COMM_RX_TIMEOUT, "it is deaf at 1 Mbaud")
    check(packet.ping(port, 5)[1] == COMM_SUCCESS, "the others are not")
    check(port.setBaudRate(115_200), "the port at 115200 baud")
    check(packet.ping(port, 6)[1] == COMM_SUCCESS, "there it answers")
    check(packet.ping(port, 5)[1] == COMM_RX_TIMEOUT, "and the others do not")
    packet.write1ByteTxRx(port, 6, BAUD, 3)
    check(port.setBaudRate(1_000_000), "back to 1 Mbaud")
    check(packet.ping(port, 6)[1] == COMM_SUCCESS, "all together again")


def every_servo(packet, port):
    """What holds of packed and of X servos alike."""
    watchdog(packet, port)
    bulk(packet, port)
    registered(packet, port)
    levels(packet, port)
