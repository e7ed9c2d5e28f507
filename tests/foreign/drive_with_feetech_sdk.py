"""Drives emulated Feetech servos with a Feetech SDK from PyPI, unmodified: ping, read, write, sync, registered writes, limits, levels, baud rate.

Usage: drive_with_feetech_sdk.py DEVICE KIND
Prints one line per check; exits 1 at the first that fails.
"""

import sys
import time

from scservo_sdk import COMM_RX_TIMEOUT, COMM_SUCCESS, GroupSyncRead, GroupSyncWrite, PacketHandler, PortHandler
from scservo_sdk import port_handler

port_handler.LATENCY_TIMER = 250

IDS = [1, 2, 3, 4, 5, 6]
# Model numbers as LeRobot knows them; the byte order as the SDK calls it: 0 STS, 1 SCS.
KINDS = {"sts": (777, 0), "scs": (1284, 1)}
# Feetech memory table.
BAUD, LEVEL, LIMITS, MODE, TORQUE, GOAL, GOAL_SPEED = 6, 8, 9, 33, 40, 42, 46
POSITION, VOLTAGE, TEMPERATURE, REGISTERED, MOVING = 56, 62, 63, 64, 66
REG_WRITE, FACTORY_RESET, REBOOT = 4, 6, 8


def check(condition, what):
    print(("ok " if condition else "FAILED ") + what, flush=True)
    if not condition:
        sys.exit(1)


def drain(port):
    """Throws away an answer that nobody waits for: `clearPort` of this SDK empties the other direction."""
    time.sleep(0.05)
    port.ser.reset_input_buffer()


def single(packet, port, model):
    for ident in IDS:
        check(packet.ping(port, ident) == (model, COMM_SUCCESS, 0), f"ping {ident}: model {model}")
    check(packet.ping(port, 99)[1] == COMM_RX_TIMEOUT, "an absent servo is a time-out")
    value, result, error = packet.read1ByteTxRx(port, 1, TEMPERATURE)
    check((result, error) == (COMM_SUCCESS, 0) and 15 < value < 60, f"temperature {value} degC")
    value, result, _ = packet.read1ByteTxRx(port, 1, VOLTAGE)
    check(result == COMM_SUCCESS and 50 < value < 170, f"{value / 10} V")
    check(packet.write1ByteTxRx(port, 1, MODE, 0) == (COMM_SUCCESS, 0), "write")
    check(packet.read2ByteTxRx(port, 1, LIMITS + 2)[0] in (4095, 1023), "angle limit from the works")


def goals(packet, port, kind, order):
    targets = {ident: (2300 if kind == "sts" else 600) + 20 * ident for ident in IDS}
    write = GroupSyncWrite(port, packet, GOAL, 2)
    for ident, goal in targets.items():
        check(packet.write1ByteTxRx(port, ident, TORQUE, 1) == (COMM_SUCCESS, 0), f"torque on {ident}")
        write.addParam(ident, list(goal.to_bytes(2, "big" if order else "little")))
    check(write.txPacket() == COMM_SUCCESS, "sync write of goals")
    read = GroupSyncRead(port, packet, POSITION, 2)
    for ident in IDS:
        read.addParam(ident)
    if kind == "scs":
        check(read.txRxPacket() == COMM_RX_TIMEOUT, "SCS has no sync read")

    def positions():
        if kind == "sts":
            read.txRxPacket()
            return [read.getData(ident, POSITION, 2) for ident in IDS]
        return [packet.read2ByteTxRx(port, ident, POSITION)[0] for ident in IDS]

    for _ in range(400):
        got = positions()
        if all(abs(p - targets[i]) <= 2 for i, p in zip(IDS, got)):
            break
        time.sleep(0.05)
    check(all(abs(p - targets[i]) <= 2 for i, p in zip(IDS, got)), f"positions reached: {got}")


def registered(packet, port, order):
    now, _, _ = packet.read2ByteTxRx(port, 3, POSITION)
    goal = (now - 60).to_bytes(2, "big" if order else "little")
    check(packet.regWriteTxRx(port, 3, GOAL, 2, list(goal)) == (COMM_SUCCESS, 0), "reg write")
    check(packet.read1ByteTxRx(port, 3, REGISTERED) == (1, COMM_SUCCESS, 0), "is registered")
    time.sleep(0.2)
    check(abs(packet.read2ByteTxRx(port, 3, POSITION)[0] - now) <= 2, "nothing moves yet")
    check(packet.action(port, 0xFE) == COMM_SUCCESS, "action")
    for _ in range(100):
        if abs(packet.read2ByteTxRx(port, 3, POSITION)[0] - (now - 60)) <= 2:
            break
        time.sleep(0.05)
    check(abs(packet.read2ByteTxRx(port, 3, POSITION)[0] - (now - 60)) <= 2, "now it does")


def levels(packet, port):
    packet.write1ByteTxOnly(port, 5, LEVEL, 0)
    drain(port)
    check(packet.write1ByteTxRx(port, 5, GOAL_SPEED, 0)[0] == COMM_RX_TIMEOUT, "level 0: a write is not answered")
    check(packet.read1ByteTxRx(port, 5, TEMPERATURE)[1] == COMM_SUCCESS, "a read is")
    packet.write1ByteTxOnly(port, 5, LEVEL, 1)
    drain(port)
    check(packet.write1ByteTxRx(port, 5, GOAL_SPEED, 0) == (COMM_SUCCESS, 0), "level 1: it is")


def bare(packet, port, ident, instruction):
    """An instruction that the SDK has no name for."""
    return packet.txRxPacket(port, [0, 0, ident, 2, instruction, 0])[1:]


def restart(packet, port, lock):
    torque = packet.read1ByteTxRx(port, 2, TORQUE)
    check(torque == (1, COMM_SUCCESS, 0), f"torque is on: {torque}")
    check(bare(packet, port, 2, REBOOT) == (COMM_SUCCESS, 0), "reboot")
    time.sleep(0.2)
    check(packet.read1ByteTxRx(port, 2, TORQUE) == (0, COMM_SUCCESS, 0), "torque is off after it")
    check(packet.write1ByteTxRx(port, 2, 26, 9) == (COMM_SUCCESS, 0), "a dead zone with the EEPROM locked")
    bare(packet, port, 2, REBOOT)
    time.sleep(0.2)
    check(packet.read1ByteTxRx(port, 2, 26) == (0, COMM_SUCCESS, 0), "is forgotten")
    packet.write1ByteTxRx(port, 2, lock, 0)
    packet.write1ByteTxRx(port, 2, 26, 9)
    bare(packet, port, 2, REBOOT)
    time.sleep(0.2)
    check(packet.read1ByteTxRx(port, 2, 26) == (9, COMM_SUCCESS, 0), "with it open it is kept")
    check(bare(packet, port, 2, FACTORY_RESET) == (COMM_SUCCESS, 0), "factory reset")
    time.sleep(0.2)
    check(packet.read1ByteTxRx(port, 2, 26) == (0, COMM_SUCCESS, 0), "and it is gone")


def baud(packet, port):
    packet.write1ByteTxOnly(port, 6, BAUD, 4)
    drain(port)
    check(packet.read1ByteTxRx(port, 6, MOVING)[1] == COMM_RX_TIMEOUT, "one at 115200 baud is deaf at 1 Mbaud")
    check(port.setBaudRate(115_200), "the port at 115200 baud")
    check(packet.read1ByteTxRx(port, 6, MOVING)[1] == COMM_SUCCESS, "there it answers")
    check(packet.read1ByteTxRx(port, 5, MOVING)[1] == COMM_RX_TIMEOUT, "and the others do not")


def main():
    kind = sys.argv[2]
    model, order = KINDS[kind]
    port = PortHandler(sys.argv[1])
    check(port.openPort(), f"open {sys.argv[1]}")
    check(port.setBaudRate(1_000_000), "1 Mbaud")
    packet = PacketHandler(order)
    single(packet, port, model)
    goals(packet, port, kind, order)
    registered(packet, port, order)
    levels(packet, port)
    restart(packet, port, 48 if kind == "scs" else 55)
    baud(packet, port)
    port.closePort()
    print("ALL CHECKS PASSED")


main()
