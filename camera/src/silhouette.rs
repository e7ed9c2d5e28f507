//! One frame of the robot's outline: one bit per pixel.

/// A bitmap, row by row from the top left; a set bit is robot.
///
/// The area and the box that holds all robot pixels are kept up to date, so that counting looks at the box alone, and
/// [`Silhouette::cropped`] stores no more than the box.
#[derive(Clone, Debug)]
pub struct Silhouette {
    width: usize,
    height: usize,
    /// What `words` covers.
    stored: Block,
    words: Vec<u64>,
    /// Smallest block of words around all robot pixels.
    robot: Block,
    area_px: u32,
}

/// Rows `top..bottom` and columns of 64 pixels `left..right`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Block {
    top: usize,
    bottom: usize,
    left: usize,
    right: usize,
}

impl Block {
    const EMPTY: Block = Block {
        top: usize::MAX,
        bottom: 0,
        left: usize::MAX,
        right: 0,
    };

    fn words_per_row(self) -> usize {
        self.right.saturating_sub(self.left)
    }

    fn rows(self) -> usize {
        self.bottom.saturating_sub(self.top)
    }

    fn include(&mut self, other: Block) {
        self.top = self.top.min(other.top);
        self.bottom = self.bottom.max(other.bottom);
        self.left = self.left.min(other.left);
        self.right = self.right.max(other.right);
    }

    fn holds(self, other: Block) -> bool {
        self.top <= other.top
            && other.bottom <= self.bottom
            && self.left <= other.left
            && other.right <= self.right
    }

    fn overlap(self, other: Block) -> Block {
        Block {
            top: self.top.max(other.top),
            bottom: self.bottom.min(other.bottom),
            left: self.left.max(other.left),
            right: self.right.min(other.right),
        }
    }
}

impl PartialEq for Silhouette {
    /// Same size and same pixels.
    fn eq(&self, other: &Self) -> bool {
        self.overlap_and_union_px(other)
            .is_some_and(|(overlap, union)| overlap == union)
    }
}

impl Eq for Silhouette {}

impl Silhouette {
    /// An empty frame.
    #[must_use]
    pub fn new(width: usize, height: usize) -> Self {
        let stored = Block {
            top: 0,
            bottom: height,
            left: 0,
            right: width.div_ceil(64),
        };
        Self {
            width,
            height,
            stored,
            words: vec![0; stored.words_per_row() * height],
            robot: Block::EMPTY,
            area_px: 0,
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

    /// The same frame that stores only what the robot covers: a film of a 0.4 m robot in a Kinect's frame needs a tenth.
    #[must_use]
    pub fn cropped(&self) -> Self {
        let robot = self.robot;
        let rows = (robot.top..robot.bottom).flat_map(|y| self.row(y, robot.left, robot.right));
        Self {
            stored: robot,
            words: rows.copied().collect(),
            ..Self {
                words: Vec::new(),
                ..*self
            }
        }
    }

    /// Bytes that the pixels take in memory.
    #[must_use]
    pub fn stored_bytes(&self) -> usize {
        size_of_val(self.words.as_slice())
    }

    /// Make the frame empty again.
    pub fn clear(&mut self) {
        for y in self.robot.top..self.robot.bottom {
            let (left, right) = (self.robot.left, self.robot.right);
            self.row_mut(y, left, right).fill(0);
        }
        self.robot = Block::EMPTY;
        self.area_px = 0;
    }

    /// Whether the pixel is robot; outside the frame nothing is.
    #[must_use]
    pub fn get(&self, x: usize, y: usize) -> bool {
        let b = self.robot;
        let inside = (b.top..b.bottom).contains(&y) && (b.left..b.right).contains(&(x / 64));
        inside && self.row(y, x / 64, x / 64 + 1)[0] >> (x % 64) & 1 == 1
    }

    /// The pixels of row `y`, 64 to a word, the lowest bit leftmost.
    #[must_use]
    pub fn row_words(&self, y: usize) -> Vec<u64> {
        let mut row = vec![0; self.width.div_ceil(64)];
        if (self.robot.top..self.robot.bottom).contains(&y) {
            let (left, right) = (self.robot.left, self.robot.right);
            row[left..right].copy_from_slice(self.row(y, left, right));
        }
        row
    }

    /// Mark the robot pixels of row `y`, given as [`Silhouette::row_words`] gives them; what stands outside the frame is ignored.
    pub fn mark_words(&mut self, y: usize, words: &[u64]) {
        if y >= self.height {
            return;
        }
        let count = self.width.div_ceil(64);
        for (column, &word) in words.iter().enumerate().take(count) {
            let past = (column + 1) * 64;
            let inside = if past > self.width {
                u64::MAX >> (past - self.width)
            } else {
                u64::MAX
            };
            if word & inside != 0 {
                self.mark(y, column, &[word & inside]);
            }
        }
    }

    /// Mark pixels `from..to` of row `y`; parts outside the frame are ignored.
    pub fn fill(&mut self, y: usize, from: usize, to: usize) {
        let to = to.min(self.width);
        if y >= self.height || from >= to {
            return;
        }
        let (first, last) = (from / 64, (to - 1) / 64);
        let head = u64::MAX << (from % 64);
        let tail = u64::MAX >> (63 - (to - 1) % 64);
        if first == last {
            self.mark(y, first, &[head & tail]);
            return;
        }
        self.mark(y, first, &[head]);
        for column in first + 1..last {
            self.mark(y, column, &[u64::MAX]);
        }
        self.mark(y, last, &[tail]);
    }

    /// Set bits in the words of row `y` from `column` on; both inside the frame.
    #[inline]
    fn mark(&mut self, y: usize, column: usize, bits: &[u64]) {
        let here = Block {
            top: y,
            bottom: y + 1,
            left: column,
            right: column + bits.len(),
        };
        if !self.stored.holds(here) {
            self.store_all();
        }
        self.robot.include(here);
        let mut added = 0;
        let words = self.row_mut(y, here.left, here.right);
        for (word, bits) in words.iter_mut().zip(bits) {
            added += (bits & !*word).count_ones();
            *word |= bits;
        }
        self.area_px += added;
    }

    /// Store the whole frame again after [`Silhouette::cropped`].
    #[cold]
    fn store_all(&mut self) {
        let mut whole = Self::new(self.width, self.height);
        let Block { left, right, .. } = self.robot;
        for y in self.robot.top..self.robot.bottom {
            whole
                .row_mut(y, left, right)
                .copy_from_slice(self.row(y, left, right));
        }
        (self.stored, self.words) = (whole.stored, whole.words);
    }

    /// Words `left..right` of row `y`, inside the stored block.
    #[inline]
    fn row(&self, y: usize, left: usize, right: usize) -> &[u64] {
        let start = (y - self.stored.top) * self.stored.words_per_row();
        &self.words[start + left - self.stored.left..start + right - self.stored.left]
    }

    #[inline]
    fn row_mut(&mut self, y: usize, left: usize, right: usize) -> &mut [u64] {
        let start = (y - self.stored.top) * self.stored.words_per_row();
        &mut self.words[start + left - self.stored.left..start + right - self.stored.left]
    }

    /// Area in pixels.
    #[must_use]
    pub fn area_px(&self) -> u32 {
        self.area_px
    }

    /// Overlap and union with another frame, in pixels; `None` when the sizes differ.
    #[must_use]
    pub fn overlap_and_union_px(&self, other: &Self) -> Option<(u32, u32)> {
        if (self.width, self.height) != (other.width, other.height) {
            return None;
        }
        let common = self.robot.overlap(other.robot);
        let mut overlap = 0;
        if common.rows() > 0 && common.words_per_row() > 0 {
            for y in common.top..common.bottom {
                let a = self.row(y, common.left, common.right);
                let b = other.row(y, common.left, common.right);
                overlap += a
                    .iter()
                    .zip(b)
                    .map(|(a, b)| (a & b).count_ones())
                    .sum::<u32>();
            }
        }
        Some((overlap, self.area_px + other.area_px - overlap))
    }

    /// Pixels (x, y) of the robot, row by row.
    pub fn marked(&self) -> impl Iterator<Item = (usize, usize)> + '_ {
        let columns = |y| (self.robot.left * 64..self.robot.right * 64).map(move |x| (x, y));
        (self.robot.top..self.robot.bottom)
            .flat_map(columns)
            .filter(|&(x, y)| self.get(x, y))
    }

    /// Centre of the area in pixels; `None` for an empty frame.
    #[must_use]
    pub fn centre_px(&self) -> Option<(f64, f64)> {
        let (mut sx, mut sy) = (0u64, 0u64);
        for (x, y) in self.marked() {
            sx += x as u64;
            sy += y as u64;
        }
        let n = f64::from(self.area_px);
        (self.area_px > 0).then(|| (sx as f64 / n + 0.5, sy as f64 / n + 0.5))
    }

    /// Fill a convex polygon given by its corners in order, either way round; a pixel belongs when its centre lies inside.
    pub fn fill_convex(&mut self, corners: &[[f32; 2]], spans: &mut Vec<[f32; 2]>) {
        let (mut top, mut bottom) = (f32::INFINITY, f32::NEG_INFINITY);
        for p in corners {
            top = top.min(p[1]);
            bottom = bottom.max(p[1]);
        }
        let limit = self.height as f32;
        // Rows whose centre line lies in the polygon.
        let first = ceil(top.clamp(0.0, limit) - 0.5);
        let end = ceil(bottom.clamp(0.0, limit) - 0.5);
        if corners.len() < 3 || first >= end {
            return;
        }
        spans.clear();
        spans.resize((end - first) as usize, [f32::INFINITY, f32::NEG_INFINITY]);
        let mut before = corners[corners.len() - 1];
        for &corner in corners {
            edge_into_spans(before, corner, first, spans);
            before = corner;
        }
        let width = self.width as f32;
        for (k, [left, right]) in spans.iter().enumerate() {
            let from = ceil(left.clamp(0.0, width) - 0.5);
            let to = ceil(right.clamp(0.0, width) - 0.5);
            self.fill(first as usize + k, from as usize, to as usize);
        }
    }

    /// Fill the hull of points in any order; a pixel belongs when its centre lies inside.
    pub fn fill_hull(&mut self, points: &mut Vec<[f32; 2]>, spans: &mut Vec<[f32; 2]>) {
        convex_hull(points);
        self.fill_convex(points, spans);
    }
}

/// Widens the span of every row whose centre line the edge crosses; `spans` begins at row `first`.
fn edge_into_spans(a: [f32; 2], b: [f32; 2], first: i32, spans: &mut [[f32; 2]]) {
    let (upper, lower) = if a[1] <= b[1] { (a, b) } else { (b, a) };
    let end = first + spans.len() as i32;
    let limit = end as f32 + 1.0;
    let from = ceil(upper[1].clamp(-1.0, limit) - 0.5).max(first);
    let to = ceil(lower[1].clamp(-1.0, limit) - 0.5).min(end);
    if from >= to {
        return;
    }
    let slope = (lower[0] - upper[0]) / (lower[1] - upper[1]);
    for row in from..to {
        let x = upper[0] + (row as f32 + 0.5 - upper[1]) * slope;
        let span = &mut spans[(row - first) as usize];
        span[0] = span[0].min(x);
        span[1] = span[1].max(x);
    }
}

/// Smallest whole number not below `x`, without a call into the platform's library; `x` within the range of i32.
#[inline]
fn ceil(x: f32) -> i32 {
    let cut = x as i32;
    cut + i32::from(x > cut as f32)
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
