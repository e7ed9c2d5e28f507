//! One frame of the robot's outline: one bit per pixel.

/// A bitmap, row by row from the top left; a set bit is robot.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Silhouette {
    width: usize,
    height: usize,
    words_per_row: usize,
    words: Vec<u64>,
}

impl Silhouette {
    /// An empty frame.
    #[must_use]
    pub fn new(width: usize, height: usize) -> Self {
        let words_per_row = width.div_ceil(64);
        Self {
            width,
            height,
            words_per_row,
            words: vec![0; words_per_row * height],
        }
    }

    /// Width in pixels.
    #[must_use]
    pub fn width(&self) -> usize {
        self.width
    }

    /// Height in pixels.
    #[must_use]
    pub fn height(&self) -> usize {
        self.height
    }

    /// Whether the pixel is robot; outside the frame nothing is.
    #[must_use]
    pub fn get(&self, x: usize, y: usize) -> bool {
        x < self.width
            && y < self.height
            && self.words[y * self.words_per_row + x / 64] >> (x % 64) & 1 == 1
    }

    /// Mark pixels `from..to` of row `y`; parts outside the frame are ignored.
    pub fn fill(&mut self, y: usize, from: usize, to: usize) {
        let to = to.min(self.width);
        if y >= self.height || from >= to {
            return;
        }
        let row = &mut self.words[y * self.words_per_row..][..self.words_per_row];
        let (first, last) = (from / 64, (to - 1) / 64);
        let head = u64::MAX << (from % 64);
        let tail = u64::MAX >> (63 - (to - 1) % 64);
        if first == last {
            row[first] |= head & tail;
            return;
        }
        row[first] |= head;
        row[first + 1..last].fill(u64::MAX);
        row[last] |= tail;
    }

    /// Area in pixels.
    #[must_use]
    pub fn area_px(&self) -> u32 {
        self.words.iter().map(|word| word.count_ones()).sum()
    }

    /// Overlap and union with another frame, in pixels; `None` when the sizes differ.
    #[must_use]
    pub fn overlap_and_union_px(&self, other: &Self) -> Option<(u32, u32)> {
        if (self.width, self.height) != (other.width, other.height) {
            return None;
        }
        let pairs = self.words.iter().zip(&other.words);
        Some(pairs.fold((0, 0), |(overlap, union), (a, b)| {
            (overlap + (a & b).count_ones(), union + (a | b).count_ones())
        }))
    }

    /// Centre of the area in pixels; `None` for an empty frame.
    #[must_use]
    pub fn centre_px(&self) -> Option<(f64, f64)> {
        let (mut n, mut sx, mut sy) = (0u64, 0u64, 0u64);
        for y in 0..self.height {
            for x in (0..self.width).filter(|&x| self.get(x, y)) {
                n += 1;
                sx += x as u64;
                sy += y as u64;
            }
        }
        (n > 0).then(|| (sx as f64 / n as f64 + 0.5, sy as f64 / n as f64 + 0.5))
    }

    /// Fill a convex polygon given by points in any order (their hull); a pixel belongs when its centre lies inside.
    pub fn fill_hull(&mut self, points: &mut Vec<[f32; 2]>) {
        convex_hull(points);
        if points.len() < 3 {
            return;
        }
        let (mut top, mut bottom) = (f32::INFINITY, f32::NEG_INFINITY);
        for p in points.iter() {
            top = top.min(p[1]);
            bottom = bottom.max(p[1]);
        }
        let first = (top - 0.5).ceil().max(0.0) as usize;
        let end = ((bottom - 0.5).floor() + 1.0).clamp(0.0, self.height as f32) as usize;
        for y in first..end {
            let line = y as f32 + 0.5;
            let (mut left, mut right) = (f32::INFINITY, f32::NEG_INFINITY);
            for (i, &a) in points.iter().enumerate() {
                let b = points[(i + 1) % points.len()];
                if (a[1] <= line) != (b[1] <= line) {
                    let x = a[0] + (line - a[1]) / (b[1] - a[1]) * (b[0] - a[0]);
                    left = left.min(x);
                    right = right.max(x);
                }
            }
            if left < right {
                let from = (left - 0.5).ceil().max(0.0) as usize;
                let to = ((right - 0.5).floor() + 1.0).max(0.0) as usize;
                self.fill(y, from, to);
            }
        }
    }
}

/// Andrew's monotone chain: keep the hull, counter-clockwise in a y-up frame.
fn convex_hull(points: &mut Vec<[f32; 2]>) {
    points.retain(|p| p[0].is_finite() && p[1].is_finite());
    points.sort_unstable_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
    points.dedup();
    if points.len() < 3 {
        return;
    }
    let turn = |o: [f32; 2], a: [f32; 2], b: [f32; 2]| {
        (a[0] - o[0]) * (b[1] - o[1]) - (a[1] - o[1]) * (b[0] - o[0])
    };
    let mut hull: Vec<[f32; 2]> = Vec::with_capacity(points.len());
    let forward = points.iter().copied();
    let backward = points.iter().rev().skip(1).copied();
    let mut floor = 2;
    for (i, p) in forward.chain(backward).enumerate() {
        if i == points.len() {
            floor = hull.len() + 1;
        }
        while hull.len() >= floor && turn(hull[hull.len() - 2], hull[hull.len() - 1], p) <= 0.0 {
            hull.pop();
        }
        hull.push(p);
    }
    hull.pop();
    *points = hull;
}
