"""Drives the emulated motors with the Robotis SDK, unmodified: ping, broadcast, read, write, sync, bulk, fast reads, registered writes, resets,
errors, stuffing.

Usage: drive_with_dynamixel_sdk.py DEVICE
Prints one line per check; exits 1 at the first that fails.
"""

import sys
import time

from dynamixel_sdk import (
    COMM_RX_TIMEOUT,
    COMM_SUCCESS,
    GroupBulkRead,
    GroupBulkWrite,
    GroupSyncRead,
    GroupSyncWrite,
    PacketHandler,
    PortHandler,
    port_handler,
)

# The adapter's latency in the SDK's time-outs [ms]: generous, so that a busy machine fails no check.
port_handler.LATENCY_TIMER = 250

IDS = [1, 2, 3, 4, 5, 6]
TORQUE, GOAL, POSITION, HARDWARE_ERROR, WATCHDOG, TEMPERATURE = 64, 116, 132, 70, 98, 146
P_GAIN, PACKED, PACKED_LEN, GOAL_ANGLE, BOOT_COUNT = 84, 1064, 19, 1024, 1048
LED, LEVEL, REGISTERED, MOVING_THRESHOLD = 65, 68, 69, 24
MODEL = 0x4252
ERR_RANGE, ERR_ACCESS, ERR_LIMIT = 4, 7, 6


def check(condition, what):
    print(("ok " if condition else "FAILED ") + what, flush=True)
    if not condition:
        sys.exit(1)


def signed(value, bits=32):
    return value - (1 << bits) if value >= 1 << (bits - 1) else value


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


def watchdog(packet, port):
    check(packet.write1ByteTxRx(port, 4, WATCHDOG, 5) == (COMM_SUCCESS, 0), "watchdog of 100 ms")
    time.sleep(0.4)
    check(packet.read1ByteTxRx(port, 4, WATCHDOG) == (255, COMM_SUCCESS, 0), "tripped reads -1")
    check(packet.write4ByteTxRx(port, 4, GOAL, 0) == (COMM_SUCCESS, ERR_ACCESS), "goals are refused")
    check(packet.write1ByteTxRx(port, 4, WATCHDOG, 0) == (COMM_SUCCESS, 0), "cleared")
    check(packet.read1ByteTxRx(port, 4, HARDWARE_ERROR) == (0, COMM_SUCCESS, 0), "no hardware error")


def main():
    port = PortHandler(sys.argv[1])
    check(port.openPort(), f"open {sys.argv[1]}")
    check(port.setBaudRate(1_000_000), "1 Mbaud")
    packet = PacketHandler(2.0)
    single(packet, port)
    errors(packet, port)
    stuffing(packet, port)
    cycles(packet, port, 300)
    watchdog(packet, port)
    bulk(packet, port)
    registered(packet, port)
    levels(packet, port)
    factory(packet, port)
    reboot(packet, port)
    port.closePort()
    print("ALL CHECKS PASSED")


main()
