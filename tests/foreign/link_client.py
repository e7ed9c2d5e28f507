#!/usr/bin/env python3
"""A client of the host link, written from docs/reference/protocol.md alone: nothing of this repository is imported.

    link_client.py HOST:PORT    hello, key, home, upload, start with proof, live samples, record, change of gait, stop with proof

Exits with 0 and "ALL CHECKS PASSED" when the robot does what the page says. Needs Python 3.9, no packages.
"""

import hashlib
import hmac
import math
import os
import socket
import struct
import sys
import time

HELLO, INFO, CHALLENGE, PUT, GET, SLOTS, ACTIVATE, ERASE, START, STOP = range(10)
CLEAR, ZERO, PING, SUBSCRIBE, EVENTS, DRAIN, BUS, SETKEY, RESET, CRASH = range(10, 20)
TETHERED, HEARTBEAT, PROVE, CHANGE = range(20, 24)
(A_HELLO, A_INFO, A_CHALLENGE, A_ACK, A_NACK, A_STORED, A_GAIT, A_SLOTS, A_SAMPLE, A_BLOCK, A_EVENT,
 A_END, A_PONG, A_BUS, A_CRASH, A_EVENTS, A_STATE) = range(17)
STATES = "Boot Unhomed Idle Armed Run Stopping Fault EStop".split()
NO_TAG = bytes(16)
M32 = 0xFFFFFFFF


# --- envelope ---------------------------------------------------------------------------------------------------

def crc32c(data):
    crc = M32
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0x82F63B78 if crc & 1 else 0)
    return crc ^ M32


def cobs(data):
    out, run = bytearray(), bytearray()
    for byte in data:
        if byte:
            run.append(byte)
        if not byte or len(run) == 254:
            out += bytes([len(run) + 1]) + run
            run.clear()
    return bytes(out + bytes([len(run) + 1]) + run)


def uncobs(data):
    out, at = bytearray(), 0
    while at < len(data):
        code = data[at]
        out += data[at + 1:at + code]
        at += code
        if code < 255 and at < len(data):
            out.append(0)
    return bytes(out)


# --- payloads ---------------------------------------------------------------------------------------------------

def varint(n):
    out = bytearray()
    while n > 127:
        out.append(n & 127 | 128)
        n >>= 7
    return bytes(out + bytes([n]))


def text(s):
    return varint(len(s.encode())) + s.encode()


class Reader:
    def __init__(self, data):
        self.data, self.at = data, 0

    def take(self, n):
        assert self.at + n <= len(self.data), "payload too short"
        self.at += n
        return self.data[self.at - n:self.at]

    def u8(self):
        return self.take(1)[0]

    def u(self):
        value = shift = 0
        while True:
            byte = self.u8()
            value |= (byte & 127) << shift
            shift += 7
            if byte < 128:
                return value

    def i(self):
        n = self.u()
        return n >> 1 ^ -(n & 1)

    def f32(self):
        return struct.unpack("<f", self.take(4))[0]

    def text(self):
        return self.take(self.u()).decode()

    def option(self, read):
        return read() if self.u8() else None

    def end(self):
        assert self.at == len(self.data), "bytes left over"


FAULT_FIELDS = {0: 1, 1: 1, 2: 2, 3: 1, 4: 1, 5: 1}


def fault(r):
    number = r.u()
    return number, [r.u8() for _ in range(FAULT_FIELDS.get(number, 0))]


def fault_info(r):
    return fault(r), r.u(), r.u()


def end_reason(r):
    number = r.u()
    return (number, fault(r)) if number == 5 else number


def event(r):
    number, t_us, kind = r.u(), r.u(), r.u()
    u8, u, i = r.u8, r.u, r.i
    fields = {
        0: [u], 1: [u, u], 2: [u8, lambda: r.take(8)], 3: [u8], 4: [u8], 5: [u8, lambda: r.take(8)],
        6: [lambda: end_reason(r)], 7: [lambda: fault_info(r)], 9: [u8, u8, i, u], 10: [u], 11: [u8], 12: [u8], 13: [u8],
        14: [u8, u8], 15: [u8], 16: [u8], 17: [u], 20: [u8], 22: [u], 23: [u8, i, i], 24: [u8], 25: [u, u],
        26: [u8, lambda: r.take(8)], 27: [u8, u],
    }
    return number, t_us, kind, [read() for read in fields.get(kind, [])]


def gait_reject(r):
    kind = r.u()
    floats = {0: [r.u, r.u8, r.f32, r.f32, r.f32], 3: [r.u8], 4: [r.u8] * 3, 5: [r.u8] * 2, 6: [r.u8] * 2,
              7: [r.u8, r.f32, r.f32]}
    return kind, [read() for read in floats.get(kind, [])]


def reject(r):
    kind = r.u()
    fields = {
        0: [r.u8, r.u8], 1: [r.u8], 10: [r.u], 11: [r.u8], 14: [lambda: r.take(8)], 15: [lambda: gait_reject(r)],
        16: [r.u], 17: [r.u], 18: [r.u8], 19: [r.u8], 20: [r.u8, r.u8, r.i], 21: [r.u, r.u], 22: [r.u],
        23: [lambda: fault(r)], 31: [r.u, r.u],
    }
    return kind, [read() for read in fields.get(kind, [])]


def sample(r):
    s = {"cycle": r.u(), "t_us": r.u(), "flags": r.u8(), "mask": r.u8(), "motors": []}
    for _ in range(6):
        s["motors"].append({
            "dt": r.u(), "setpoint": r.i(), "tick": r.u(), "applied": r.i(), "position": r.i(), "velocity": r.i(),
            "current": r.i(), "duty": r.i(), "voltage": r.u(), "temperature": r.i(), "status": r.u8(), "boots": r.u8()})
    return s


def answer(kind, payload):
    """The fields of a message of the module."""
    r = Reader(payload)
    if kind == A_HELLO:
        m = {"protocol": r.u8(), "robot_id": r.u8(), "boot_id": r.u(), "firmware": r.text(), "model": r.take(8),
             "keyed": r.u8()}
    elif kind == A_INFO:
        m = {"state": STATES[r.u()], "fault": r.option(lambda: fault_info(r)), "cause": r.u(), "slots": r.u8(),
             "active": r.option(r.u8), "battery_mv": r.u(), "homed": r.u8(), "motors": r.u8(), "uptime_us": r.u(),
             "cycles": r.u(), "counters": [r.u() for _ in range(17)]}
    elif kind == A_CHALLENGE:
        m = {"nonce": r.take(16)}
    elif kind == A_ACK:
        m = {"request": r.u8()}
    elif kind == A_NACK:
        m = {"request": r.u8(), "reason": reject(r)}
    elif kind == A_STORED:
        m = {"slot": r.u8(), "digest": r.take(8), "active": r.u8()}
    elif kind == A_SLOTS:
        slot = lambda: (r.text(), r.take(8), r.u())
        m = {"active": r.option(r.u8), "slots": [r.option(slot) for _ in range(r.u())]}
    elif kind == A_SAMPLE:
        m = sample(r)
    elif kind == A_BLOCK:
        m = {"run": r.u(), "first": r.u(), "count": r.u8(), "dropped": r.u(), "data": r.take(r.u())}
    elif kind == A_EVENT:
        m = {"event": event(r)}
    elif kind == A_END:
        m = {"run": r.u(), "reason": end_reason(r), "cycles": r.u(), "holds": r.u(), "samples": r.u(), "dropped": r.u(),
             "crc": r.u()}
    elif kind == A_PONG:
        m = {"host": r.u(), "module": r.u()}
    elif kind == A_EVENTS:
        m = {"next": r.u(), "lost": r.u(), "events": [event(r) for _ in range(r.u())]}
    elif kind == A_STATE:
        m = {"state": STATES[r.u()], "uptime_us": r.u(), "tag": r.take(16)}
    else:
        return {"kind": kind, "raw": payload}
    r.end()
    m["kind"] = kind
    return m


# --- sample blocks ----------------------------------------------------------------------------------------------

FIELDS = "position velocity current duty setpoint dt voltage tick applied temperature status boots".split()
HEAD_SIZES = [[9, 24, 2, 6], [1, 15, 1, 0], [None, 0, None, None]]
MOTOR_SIZES = [[14, 9, 6, 7, 18, 3, 2, 14, 0, 1, 1, 0], [11, 6, 5, 5, None, 2, 1, 1, 0, 0, 0, 0], [8] + [None] * 11]
STEP_SIZES = [13, 10, 7, 4]


def signed(n, bits):
    n &= (1 << bits) - 1
    return n - (1 << bits) if n >> bits - 1 else n


class Bits:
    def __init__(self, data):
        self.data, self.at = data, 0

    def take(self, width):
        value = 0
        for bit in range(width):
            value |= (self.data[self.at >> 3] >> (self.at & 7) & 1) << bit
            self.at += 1
        return value

    def align(self):
        while self.at & 7:
            assert self.take(1) == 0, "the rest of a sample's last byte is zero"


def rice(bits, sizes, index):
    s = sizes[index]
    k = min(30, max(0, (s >> 2).bit_length() - 1))
    ones = 0
    while ones < 12 and bits.take(1):
        ones += 1
    c = bits.take(32) if ones == 12 else ones << k | bits.take(k)
    sizes[index] = min(M32, s - (s >> 2) + c)
    return signed(c >> 1 ^ -(c & 1), 32)


def set_sizes(sizes, table, n):
    if n < len(table):
        for index, size in enumerate(table[n]):
            if size is not None:
                sizes[index] = 4 << size


class Motor:
    """What is remembered of one motor within a block."""

    def __init__(self):
        self.sizes = [0] * 12
        self.steps, self.known = [0, 0, 0], 0
        self.step = self.excess = self.straight = self.measured = 0
        self.moved_before = False

    def expected_step(self, moved):
        a, b, c = self.steps
        return [moved, a, 2 * a - b][self.known] if self.known < 3 else 3 * (a - b) + c

    def decode(self, bits, n, last, t):
        differs = bits.take(1)
        if n > 0 and self.known < 4:
            self.sizes[4] = 4 << STEP_SIZES[self.known]
        v = {name: rice(bits, self.sizes, i) if name != "setpoint" or differs else 0 for i, name in enumerate(FIELDS)}
        now = {"velocity": signed(last["velocity"] + v["velocity"], 16),
               "current": signed(last["current"] + v["current"], 16), "duty": signed(last["duty"] + v["duty"], 16),
               "voltage": last["voltage"] + v["voltage"] & 0xFFFF,
               "temperature": signed(last["temperature"] + v["temperature"], 16)}
        product = (last["velocity"] + now["velocity"]) * t
        moved = signed(abs(product) // 4000 * (1 if product >= 0 else -1), 32)
        step = v["setpoint"] + self.expected_step(moved) if differs else 0
        now["setpoint"] = signed(last["setpoint"] + step, 32)
        now["dt"] = last["dt"] + v["dt"] & M32
        now["tick"] = last["tick"] + (t + now["dt"] - last["dt"] >> 2) + v["tick"] & 0xFFFF
        now["applied"] = signed(now["setpoint"] + last["applied"] - last["setpoint"] + v["applied"], 32)
        expected = self.step if self.straight < self.measured else moved + self.excess
        now["position"] = signed(last["position"] + v["position"] + expected, 32)
        rotated = v["status"] & 0xFF
        now["status"] = last["status"] ^ (rotated >> 2 | rotated << 6 & 0xFF)
        now["boots"] = last["boots"] ^ v["boots"]
        if n == 0:
            now["position"] = signed(now["position"] + now["setpoint"], 32)
        else:
            self.follow(last, now, moved)
        return now

    def follow(self, last, now, moved):
        p = signed(now["position"] - last["position"], 32)
        x = signed(p - moved, 32)
        if self.moved_before:
            mean = lambda old, error: min(M32, old - (old >> 2) + abs(signed(error, 32)))
            self.straight = mean(self.straight, p - self.step)
            self.measured = mean(self.measured, x - self.excess)
        self.step, self.excess, self.moved_before = p, x, True
        step = signed(now["setpoint"] - last["setpoint"], 32)
        if step:
            self.steps, self.known = [step] + self.steps[:2], self.known + 1


NOTHING = dict.fromkeys(FIELDS, 0)


def samples(block):
    """The samples of a block, in the form of `sample`."""
    bits, head, motors = Bits(block["data"]), [0] * 4, [Motor() for _ in range(6)]
    last = {"cycle": 0, "t_us": 0, "flags": 0, "mask": 0, "motors": [NOTHING] * 6}
    t_step, out = 0, []
    for n in range(block["count"]):
        set_sizes(head, HEAD_SIZES, n)
        for motor in motors:
            set_sizes(motor.sizes, MOTOR_SIZES, n)
        cycle = last["cycle"] + rice(bits, head, 0) & M32
        d = rice(bits, head, 1)
        if bits.take(1):
            d = bits.take(32) << 32 | d & M32
        t_us = last["t_us"] + t_step + d & (1 << 64) - 1
        flags, mask = last["flags"] ^ rice(bits, head, 2), last["mask"] ^ rice(bits, head, 3)
        before, decoded = NOTHING, []
        for motor, own in zip(motors, last["motors"]):
            if n == 0:
                own = dict(before, setpoint=0, position=0, velocity=0, current=0, duty=0,
                           applied=before["applied"] - before["setpoint"])
            before = motor.decode(bits, n, own, t_us - last["t_us"] if n else 0)
            decoded.append(before)
        bits.align()
        if n:
            t_step = t_us - last["t_us"]
        last = {"cycle": cycle, "t_us": t_us, "flags": flags, "mask": mask, "motors": decoded}
        out.append(last)
    assert bits.at == 8 * len(block["data"]), "bytes are left after the last sample"
    return out


# --- conversation -----------------------------------------------------------------------------------------------

class Refused(Exception):
    pass


class Client:
    def __init__(self, address):
        host, port = address.rsplit(":", 1)
        self.socket = socket.create_connection((host, int(port)))
        self.sequence = int.from_bytes(os.urandom(2), "little") & 0x7FFF
        self.boot_id, self.key, self.rest = 0, None, b""
        self.unasked = []

    def frame(self, kind, payload):
        body = struct.pack("<BBHIB", 1, 0, self.sequence, self.boot_id, kind) + payload
        return b"\0" + cobs(body + struct.pack("<I", crc32c(body))) + b"\0"

    def messages(self, wait_s):
        """What has come, as (sequence, message)."""
        self.socket.settimeout(wait_s)
        try:
            data = self.socket.recv(4096)
            assert data, "the robot hung up"
        except socket.timeout:
            data = b""
        *frames, self.rest = (self.rest + data).split(b"\0")
        for frame in filter(None, frames):
            body = uncobs(frame)
            assert crc32c(body[:-4]) == struct.unpack("<I", body[-4:])[0], "CRC"
            version, source, sequence, boot_id, kind = struct.unpack("<BBHIB", body[:9])
            assert version == 1 and 1 <= source <= 254
            message = answer(kind, body[9:-4])
            yield sequence, message

    def ask(self, kind, payload=b"", patience_s=20.0):
        """The answer to a request, which is sent again, byte for byte, when none comes."""
        frame = self.frame(kind, payload)
        sent, self.sequence = self.sequence, self.sequence + 1 & 0x7FFF
        give_up = time.monotonic() + patience_s
        while time.monotonic() < give_up:
            self.socket.sendall(frame)
            again = time.monotonic() + 1.0
            while time.monotonic() < again:
                found = None
                for sequence, message in self.messages(0.05):
                    if sequence == sent:
                        found = message
                    else:
                        self.unasked.append(message)
                if found:
                    if found["kind"] == A_NACK:
                        raise Refused(found["reason"])
                    return found
        raise AssertionError(f"no answer to {kind}")

    def order(self, kind, payload=b""):
        """An order with its proof."""
        if self.key is None:
            return self.ask(kind, payload + NO_TAG)
        nonce = self.ask(CHALLENGE)["nonce"]
        signed_bytes = b"rb-link/1 order\0" + nonce + bytes([kind]) + payload
        return self.ask(kind, payload + hmac.new(self.key, signed_bytes, hashlib.sha256).digest()[:16])

    def listen(self, seconds):
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.unasked += [message for _, message in self.messages(0.05)]

    def come(self, kind):
        return [message for message in self.unasked if message["kind"] == kind]


def gait(name, amplitude, lag):
    out = text(name) + struct.pack("<fff", 0.2, 2.0, 30.0) + varint(6)
    for joint in range(6):
        out += struct.pack("<fff", amplitude, 0.02 * joint, 0.0)
    out += varint(5)
    for joint in range(5):
        out += bytes([joint, joint + 1]) + struct.pack("<ff", 0.5, lag)
    return out


def digest(wire_gait):
    return hashlib.sha256(wire_gait).digest()[:8]


def refuses(reason, call):
    try:
        call()
    except Refused as refused:
        found = refused.args[0]
        assert found[0] == reason, (reason, found)
        return found
    raise AssertionError(f"not refused with {reason}")


def wait_for(client, state, seconds=60.0):
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        info = client.ask(INFO)
        if info["state"] == state:
            return info
        client.listen(0.1)
    raise AssertionError(f"never {state}, but {info}")


def check_page():
    """The examples of the page."""
    assert crc32c(b"123456789") == 0xE3069283
    tag = hmac.new(b"\x4b" * 32, b"rb-link/1 order\0" + b"\x11" * 16 + b"\x03payload", hashlib.sha256).digest()[:16]
    assert tag.hex() == "44057c1badd72dfee1351d47304fc63b"


def prepare(client):
    hello = client.ask(HELLO, b"\x01")
    assert hello["protocol"] == 1 and not hello["keyed"]
    client.boot_id = hello["boot_id"]
    print("hello from robot", hello["robot_id"], hello["firmware"])
    info = client.ask(INFO)
    assert info["state"] in ("Unhomed", "Idle"), info
    refuses(0, lambda: client.ask(HELLO, b"\x09"))
    refuses(1, lambda: client.ask(99))
    client.key = os.urandom(32)
    client.ask(SETKEY, client.key)
    refuses(6, lambda: client.ask(ZERO, b"\x3f" + NO_TAG))
    client.order(ZERO, b"\x3f")
    assert client.ask(INFO)["homed"] == 63


def upload(client):
    first, second = gait("python one", 0.3, 1.0), gait("python two", 0.2, -1.0)
    for slot, wire in enumerate([first, second]):
        stored = client.order(PUT, bytes([slot, 0]) + wire)
        assert stored["digest"] == digest(wire), "the digest of the page"
    bad = gait("too wide", 4.0, 1.0)
    field, index, value, low, high = refuses(15, lambda: client.order(PUT, b"\x02\x00" + bad))[1][0][1]
    assert (field, index, value, low) == (3, 0, 4.0, 0.0) and abs(high - math.pi) < 1e-6
    slots = client.ask(SLOTS)
    assert [slot[0] for slot in slots["slots"][:2]] == ["python one", "python two"]
    return first, second


def run(client, first, second):
    """A tethered run with live samples, a change of gait in the middle, and its whole record."""
    client.ask(SUBSCRIBE, b"\x01")
    order = b"\x00" + digest(first) + varint(6000) + b"\x01" + varint(0) + varint(1500)
    client.order(TETHERED, order)
    changed = False
    while not client.come(A_END):
        client.listen(0.2)
        try:
            client.order(HEARTBEAT)
            if not changed and client.ask(INFO)["state"] == "Run":
                client.order(CHANGE, b"\x01" + digest(second))
                changed = True
        except Refused as refused:
            assert refused.args[0][0] in (6, 32), refused  # the run is over
    end = client.come(A_END)[-1]
    print("run", end["run"], "ended with reason", end["reason"], "after", end["cycles"], "cycles")
    assert (end["reason"], end["cycles"], end["dropped"]) == (0, 120, 0), end
    assert changed and any(e["event"][2] == 26 for e in client.come(A_EVENT)), "GaitChanged"
    check_record(client, end)


def check_record(client, end):
    record, at = {}, 0
    while True:
        block = client.ask(DRAIN, varint(at))
        if block["count"] == 0:
            break
        for index, one in enumerate(samples(block), block["first"]):
            record[index] = one
        at = block["first"] + block["count"]
    assert sorted(record) == list(range(end["samples"])), "every sample once"
    for block in client.come(A_BLOCK):
        for index, one in enumerate(samples(block), block["first"]):
            assert record[index] == one, "a block that came unasked holds the same"
    times = [record[index]["t_us"] for index in sorted(record)]
    assert all(b - a == 50_000 for a, b in zip(times, times[1:])), "20 Hz"
    moved = [one["motors"][0]["position"] for one in record.values()]
    assert max(moved) - min(moved) > 100_000, "more than 0.1 rad"
    lag = [abs(m["position"] - m["setpoint"]) for one in record.values() for m in one["motors"] if one["mask"] == 63]
    assert max(lag) < 300_000, f"{max(lag)} urad"
    # Live samples are the same cycles in plain words.
    by_time = {one["t_us"]: one for one in record.values()}
    both = [live for live in client.come(A_SAMPLE) if live["t_us"] in by_time]
    assert len(both) > 20
    for live in both:
        assert live["motors"] == by_time[live["t_us"]]["motors"], "coded and plain are equal"
    print(len(record), "samples in blocks,", len(both), "of them also live")


def stop(client, first):
    client.ask(SUBSCRIBE, b"\x00")
    wait_for(client, "Idle")
    client.order(START, b"\x00" + digest(first) + varint(60_000) + b"\x00" + varint(0))
    wait_for(client, "Run")
    client.ask(STOP)
    nonce = os.urandom(16)
    state = client.ask(PROVE, nonce)
    payload = bytes([STATES.index(state["state"])]) + varint(state["uptime_us"])
    proof = hmac.new(client.key, b"rb-link/1 state\0" + nonce + b"\x10" + payload, hashlib.sha256).digest()[:16]
    assert proof == state["tag"] and state["state"] == "Stopping", state
    wait_for(client, "Idle")
    events, since = [], 0
    while True:
        part = client.ask(EVENTS, varint(since))
        if not part["events"]:
            break
        events, since = events + part["events"], part["next"]
    kinds = [kind for _, _, kind, _ in events]
    assert kinds[0] == 0 and 24 in kinds and 26 in kinds, kinds
    pong = client.ask(PING, varint(123_456_789))
    assert pong["host"] == 123_456_789 and pong["module"] > events[-1][1]


def main():
    check_page()
    client = Client(sys.argv[1])
    prepare(client)
    first, second = upload(client)
    run(client, first, second)
    stop(client, first)
    print("ALL CHECKS PASSED")


if __name__ == "__main__":
    main()
