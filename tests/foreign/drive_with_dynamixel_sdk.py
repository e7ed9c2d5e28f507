"""Drives the emulated motors with the Robotis SDK, unmodified: ping, broadcast, read, write, sync, bulk, fast reads, registered writes, resets,
errors, stuffing.

Usage: drive_with_dynamixel_sdk.py DEVICE
Prints one line per check; exits 1 at the first that fails.
"""

import sys
import time

from dynamixel_sdk import COMM_RX_TIMEOUT, COMM_SUCCESS, GroupSyncRead, GroupSyncWrite, PacketHandler, PortHandler
from dynamixel_checks import ERR_ACCESS, ERR_LIMIT, GOAL, P_GAIN, POSITION, TORQUE, baud, check, every_servo, signed

IDS = [1, 2, 3, 4, 5, 6]
TEMPERATURE, PACKED, PACKED_LEN, GOAL_ANGLE, BOOT_COUNT, MOVING_THRESHOLD = 146, 1064, 19, 1024, 1048, 24
MODEL = 0x4252
ERR_RANGE = 4


def single(packet, port):
    for ident in IDS:
        model, result, error = packet.ping(port, ident)
        check((model, result, error) == (MODEL, COMM_SUCCESS, 0), f"ping {ident}")
    found, result = packet.broadcastPing(port)
    check(result == COMM_SUCCESS and sorted(found) == IDS, f"broadcast ping finds {sorted(found)}")
    _, result, _ = packet.ping(port, 99)
    check(result == COMM_RX_TIMEOUT, "an absent driver is a time-out")
    value, result, error = packet.read1ByteTxRx(port, 1, TEMPERATURE)
    check((result, error) == (COMM_SUCCESS, 0) and 15 < value < 60, f"temperature {value} degC")
    check(packet.write2ByteTxRx(port, 1, P_GAIN, 640) == (COMM_SUCCESS, 0), "write gain")
    check(packet.read2ByteTxRx(port, 1, P_GAIN) == (640, COMM_SUCCESS, 0), "read gain back")


def errors(packet, port):
    check(packet.write4ByteTxRx(port, 1, POSITION, 5) == (COMM_SUCCESS, ERR_ACCESS), "read-only register: access error")
    check(packet.write2ByteTxRx(port, 1, P_GAIN, 20000) == (COMM_SUCCESS, ERR_RANGE), "gain out of range: range error")
    check(packet.write1ByteTxRx(port, 1, TORQUE, 1) == (COMM_SUCCESS, 0), "torque on")
    check(packet.write1ByteTxRx(port, 1, 7, 9) == (COMM_SUCCESS, ERR_ACCESS), "address change under torque: access error")
    far = 3_000_000
    check(packet.write4ByteTxRx(port, 1, GOAL_ANGLE, far) == (COMM_SUCCESS, ERR_LIMIT), "implausible set-point: limit error")
    check(packet.write1ByteTxRx(port, 1, TORQUE, 0) == (COMM_SUCCESS, 0), "torque off")


def stuffing(packet, port):
    # Bytes FF FF FD FF, so stuffed on the wire in both directions. 32 turns away, but torque is off.
    raw = 0xFFFDFFFF
    check(packet.write4ByteTxRx(port, 2, GOAL, raw) == (COMM_SUCCESS, 0), f"goal {signed(raw)} holds FF FF FD")
    got, result, error = packet.read4ByteTxRx(port, 2, GOAL)
    check((got, result, error) == (raw, COMM_SUCCESS, 0), "and is read back whole")
    check(packet.write4ByteTxRx(port, 2, GOAL, 0) == (COMM_SUCCESS, 0), "goal back to 0")


def cycles(packet, port, count):
    write = GroupSyncWrite(port, packet, GOAL, 4)
    read = GroupSyncRead(port, packet, POSITION, 4)
    fast = GroupSyncRead(port, packet, PACKED, PACKED_LEN)
    for ident in IDS:
        check(packet.write1ByteTxRx(port, ident, TORQUE, 1) == (COMM_SUCCESS, 0), f"torque on {ident}")
        read.addParam(ident)
        fast.addParam(ident)
    target = 0
    times = []
    for cycle in range(count):
        target = min(500, target + 5)
        write.clearParam()
        for ident in IDS:
            goal = target if ident % 2 else -target
            write.addParam(ident, list((goal & 0xFFFFFFFF).to_bytes(4, "little")))
        begun = time.monotonic()
        if write.txPacket() != COMM_SUCCESS:
            check(False, f"sync write in cycle {cycle}")
        result = fast.fastSyncRead() if cycle % 2 else read.txRxPacket()
        if result != COMM_SUCCESS:
            check(False, f"{'fast ' * (cycle % 2)}sync read in cycle {cycle}")
        times.append(time.monotonic() - begun)
    times.sort()
    print(f"     {count} cycles: median {times[len(times) // 2] * 1e3:.2f} ms, longest {times[-1] * 1e3:.2f} ms")
    blocks = [fast.data_dict[ident] for ident in IDS]
    check(all(len(block) == PACKED_LEN for block in blocks), "packed blocks by fast sync read")
    check(True, f"{count} cycles of sync write and (fast) sync read")
    for _ in range(400):
        check_read = read.txRxPacket()
        positions = [signed(read.getData(ident, POSITION, 4)) for ident in IDS]
        if check_read == COMM_SUCCESS and all(abs(abs(p) - 500) <= 2 for p in positions):
            break
        time.sleep(0.05)
    check(all(abs(p - (500 if i % 2 else -500)) <= 2 for i, p in zip(IDS, positions)), f"positions reached: {positions}")


def factory(packet, port):
    check(packet.write1ByteTxRx(port, 6, TORQUE, 0) == (COMM_SUCCESS, 0), "torque off")
    check(packet.write4ByteTxRx(port, 6, MOVING_THRESHOLD, 99) == (COMM_SUCCESS, 0), "an EEPROM register changed")
    check(packet.factoryReset(port, 6, 0x02) == (COMM_SUCCESS, 0), "factory reset but id and baud rate")
    time.sleep(0.1)
    value, result, _ = packet.read4ByteTxRx(port, 6, MOVING_THRESHOLD)
    check(result == COMM_SUCCESS and value != 99, f"it is {value} again, under the same id")


def reboot(packet, port):
    before, _, _ = packet.read1ByteTxRx(port, 3, BOOT_COUNT)
    check(packet.reboot(port, 3) == (COMM_SUCCESS, 0), "reboot")
    time.sleep(0.1)
    after, result, _ = packet.read1ByteTxRx(port, 3, BOOT_COUNT)
    check(result == COMM_SUCCESS and after == (before + 1) % 256, "boot count went up by one")
    check(packet.read1ByteTxRx(port, 3, TORQUE) == (0, COMM_SUCCESS, 0), "torque is off after it")
    position, _, _ = packet.read4ByteTxRx(port, 3, POSITION)
    check(abs(signed(position)) <= 2, "and the zero is where it stands")


def main():
    port = PortHandler(sys.argv[1])
    check(port.openPort(), f"open {sys.argv[1]}")
    check(port.setBaudRate(1_000_000), "1 Mbaud")
    packet = PacketHandler(2.0)
    single(packet, port)
    errors(packet, port)
    stuffing(packet, port)
    cycles(packet, port, 300)
    every_servo(packet, port)
    factory(packet, port)
    reboot(packet, port)
    baud(packet, port)
    port.closePort()
    print("ALL CHECKS PASSED")


main()
