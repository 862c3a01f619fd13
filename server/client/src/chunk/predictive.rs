//! The coding `predictive`: section 4.1 of the protocol.

use std::collections::HashMap;

use super::Vertex;

/// The models of bits: of each kind, by context.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
enum Kind {
    CornerNew,
    Behind,
    SameLevel,
    Level,
    New,
    Right,
    Left,
    Longer(Number),
    Negative(Number),
    Below(Number),
}

/// The models of numbers.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
enum Number {
    Age,
    Corner,
    Across,
    Depth,
    Smoothness,
    Feature,
    Normal,
}

struct Reader<'a> {
    payload: &'a [u8],
    at: usize,
    code: u32,
    range: u32,
    /// Probability and count.
    models: HashMap<(Kind, usize), (u32, u32)>,
}

impl<'a> Reader<'a> {
    fn new(payload: &'a [u8]) -> Result<Self, String> {
        let mut reader = Self {
            payload,
            at: 0,
            code: 0,
            range: u32::MAX,
            models: HashMap::new(),
        };
        for _ in 0..4 {
            reader.byte()?;
        }
        Ok(reader)
    }

    fn byte(&mut self) -> Result<(), String> {
        let byte = self.payload.get(self.at).ok_or("too short")?;
        self.code = self.code << 8 | u32::from(*byte);
        self.at += 1;
        Ok(())
    }

    fn fill(&mut self) -> Result<(), String> {
        while self.range < 1 << 24 {
            self.range <<= 8;
            self.byte()?;
        }
        Ok(())
    }

    fn bit(&mut self, kind: Kind, context: usize) -> Result<bool, String> {
        let (p, n) = self.models.entry((kind, context)).or_insert((32768, 0));
        let bound = (self.range >> 12) * (*p >> 4).clamp(16, 4080);
        let rate = 131_072 / (2 * *n + 5);
        *n = (*n + 1).min(100);
        let bit = self.code < bound;
        if bit {
            self.range = bound;
            *p += ((65535 - *p) * rate) >> 16;
        } else {
            self.code -= bound;
            self.range -= bound;
            *p -= (*p * rate) >> 16;
        }
        self.fill()?;
        Ok(bit)
    }

    fn raw(&mut self, bits: u32) -> Result<i32, String> {
        let mut value = 0;
        for _ in 0..bits {
            self.range >>= 1;
            let bit = self.code >= self.range;
            self.code -= if bit { self.range } else { 0 };
            value = 2 * value + i32::from(bit);
            self.fill()?;
        }
        Ok(value)
    }

    fn number(&mut self, model: Number, context: usize) -> Result<i32, String> {
        let mut bits = 0;
        while bits < 20 && self.bit(Kind::Longer(model), 20 * context + bits)? {
            bits += 1;
        }
        if bits == 0 {
            return Ok(0);
        }
        let sign = if self.bit(Kind::Negative(model), context)? {
            -1
        } else {
            1
        };
        let mut magnitude = 1;
        for place in 0..bits - 1 {
            let bit = match place {
                0 => i32::from(self.bit(Kind::Below(model), 3 * bits)?),
                1 => i32::from(self.bit(Kind::Below(model), 3 * bits + 1 + (magnitude & 1) as usize)?),
                _ => self.raw(1)?,
            };
            magnitude = 2 * magnitude + bit;
        }
        Ok(sign * magnitude)
    }
}

#[derive(Clone, Copy)]
struct Edge {
    from: usize,
    to: usize,
    opposite: usize,
    level: u32,
    previous: usize,
    next: usize,
    open: bool,
    bare: bool,
}

/// What was decoded so far.
struct Decoder<'a> {
    reader: Reader<'a>,
    edges: Vec<Edge>,
    ending: Vec<usize>,
    vertices: Vec<Vertex>,
    sums: Vec<[f64; 3]>,
    counts: Vec<usize>,
    triangles: Vec<(u32, [u32; 3])>,
}

/// What a payload holds.
pub struct Mesh {
    pub vertices: Vec<Vertex>,
    /// Ordered by level.
    pub triangles: Vec<[u32; 3]>,
    pub levels: [u32; 6],
}

/// Decodes a payload of `vertices` vertices and `triangles` triangles.
pub fn decode(payload: &[u8], vertices: usize, triangles: usize) -> Result<Mesh, String> {
    let mut decoder = Decoder {
        reader: Reader::new(payload)?,
        edges: Vec::new(),
        ending: Vec::new(),
        vertices: Vec::new(),
        sums: Vec::new(),
        counts: Vec::new(),
        triangles: Vec::new(),
    };
    let mut level = 0;
    while decoder.triangles.len() < triangles {
        level = decoder.level(level)?;
        let mut stack = decoder.start(level)?;
        while let Some(edge) = stack.pop() {
            if decoder.edges[edge].open {
                stack.extend(decoder.follow(edge)?);
            }
            if decoder.triangles.len() > triangles || decoder.vertices.len() > vertices {
                return Err("more than the header says".into());
            }
        }
    }
    decoder.normals()?;
    if decoder.vertices.len() != vertices || decoder.reader.at != payload.len() {
        return Err(format!(
            "{} of {vertices} vertices, {} of {} bytes",
            decoder.vertices.len(),
            decoder.reader.at,
            payload.len()
        ));
    }
    decoder.triangles.sort_by_key(|(level, _)| *level);
    let mut levels = [0; 6];
    for (level, _) in &decoder.triangles {
        levels[*level as usize] += 1;
    }
    Ok(Mesh {
        vertices: decoder.vertices,
        triangles: decoder.triangles.iter().map(|(_, corners)| *corners).collect(),
        levels,
    })
}

impl Decoder<'_> {
    fn level(&mut self, before: u32) -> Result<u32, String> {
        let mut read = 1;
        for _ in 0..3 {
            read = 2 * read + usize::from(self.reader.bit(Kind::Level, 8 * before as usize + read)?);
        }
        if read > 13 {
            Err(format!("level {}", read - 8))
        } else {
            Ok(read as u32 - 8)
        }
    }

    fn start(&mut self, level: u32) -> Result<Vec<usize>, String> {
        let mut corners = [0; 3];
        for (place, corner) in corners.iter_mut().enumerate() {
            *corner = if self.reader.bit(Kind::CornerNew, place)? {
                self.corner(place)?
            } else {
                self.old()?
            };
        }
        let [a, b, c] = corners;
        self.triangle([a, b, c], level);
        let first = self.edges.len();
        for (i, (from, to, opposite)) in [(a, c, b), (c, b, a), (b, a, c)].into_iter().enumerate() {
            self.ending[to] = first + i;
            self.edges.push(Edge {
                from,
                to,
                opposite,
                level,
                previous: first + (i + 2) % 3,
                next: first + (i + 1) % 3,
                open: true,
                bare: false,
            });
        }
        Ok(vec![first, first + 1, first + 2])
    }

    /// Edges for the stack.
    fn follow(&mut self, id: usize) -> Result<Vec<usize>, String> {
        let edge = self.edges[id];
        let (previous, next) = (self.edges[edge.previous], self.edges[edge.next]);
        if !self
            .reader
            .bit(Kind::Behind, usize::from(previous.bare) + 2 * usize::from(next.bare))?
        {
            self.edges[id].bare = true;
            return Ok(Vec::new());
        }
        let context = usize::from(previous.level != edge.level) + 2 * usize::from(next.level != edge.level);
        let level = if self.reader.bit(Kind::SameLevel, context)? {
            edge.level
        } else {
            self.level(edge.level)?
        };
        let (a, b) = (edge.from, edge.to);
        let context = self.counts[a].min(7) + 8 * self.counts[b].min(7);
        let is_new = self.reader.bit(Kind::New, context)?;
        let is_right = !is_new && self.reader.bit(Kind::Right, context)?;
        let is_left = !is_new && !is_right && self.reader.bit(Kind::Left, context)?;
        let c = match (is_new, is_right, is_left) {
            (true, ..) => self.behind(&edge)?,
            (_, true, _) => next.to,
            (.., true) => previous.from,
            _ => self.old()?,
        };
        self.triangle([a, b, c], level);
        let met = self.ending[c];
        let has_met = self.edges.get(met).is_some_and(|edge| edge.open && edge.to == c) && met != id;
        let (one, two) = (self.edges.len(), self.edges.len() + 1);
        let new = Edge {
            from: a,
            to: c,
            opposite: b,
            level,
            previous: edge.previous,
            next: two,
            open: true,
            bare: false,
        };
        self.edges.push(new);
        self.edges.push(Edge {
            from: c,
            to: b,
            opposite: a,
            previous: one,
            next: edge.next,
            ..new
        });
        self.edges[id].open = false;
        self.edges[edge.previous].next = one;
        self.edges[edge.next].previous = two;
        (self.ending[b], self.ending[c]) = (two, one);
        if !(is_new || is_right || is_left) && has_met {
            let after = self.edges[met].next;
            self.join(one, after);
            self.join(met, two);
        }
        if is_right {
            self.close(two, edge.next);
            self.ending[c] = one;
        }
        if is_left || is_right && previous.from == c {
            let before = self.edges[one].previous;
            self.ending[c] = self.edges[before].previous;
            self.close(before, one);
        }
        Ok([one, two].into_iter().filter(|&new| self.edges[new].open).collect())
    }

    fn join(&mut self, first: usize, second: usize) {
        self.edges[first].next = second;
        self.edges[second].previous = first;
    }

    fn close(&mut self, first: usize, second: usize) {
        (self.edges[first].open, self.edges[second].open) = (false, false);
        let (before, after) = (self.edges[first].previous, self.edges[second].next);
        self.join(before, after);
    }

    fn old(&mut self) -> Result<usize, String> {
        let age = self.reader.number(Number::Age, 0)?;
        let count = self.vertices.len() as i32;
        if age < 0 || age >= count {
            Err(format!("age {age} of {count} vertices"))
        } else {
            Ok((count - 1 - age) as usize)
        }
    }

    fn position(&self, vertex: usize) -> [i32; 3] {
        self.vertices[vertex].position.map(i32::from)
    }

    fn triangle(&mut self, corners: [usize; 3], level: u32) {
        let [a, b, c] = corners.map(|corner| self.position(corner).map(f64::from));
        let [u, v] = [b, c].map(|end| [0, 1, 2].map(|i| end[i] - a[i]));
        let cross = [0, 1, 2].map(|i| u[(i + 1) % 3] * v[(i + 2) % 3] - u[(i + 2) % 3] * v[(i + 1) % 3]);
        for corner in corners {
            self.sums[corner] = [0, 1, 2].map(|i| self.sums[corner][i] + cross[i]);
            self.counts[corner] += 1;
        }
        self.triangles.push((level, corners.map(|corner| corner as u32)));
    }

    fn add(&mut self, position: [i32; 3], [smoothness, feature]: [u16; 2]) -> usize {
        self.vertices.push(Vertex {
            position: position.map(|p| p as i16),
            normal: [0; 2],
            smoothness,
            feature,
        });
        self.sums.push([0.0; 3]);
        self.counts.push(0);
        self.ending.push(usize::MAX);
        self.vertices.len() - 1
    }

    fn features(&self, vertex: usize) -> [i32; 2] {
        let vertex = self.vertices[vertex];
        [vertex.smoothness, vertex.feature].map(|v| if v == 65535 { 256 } else { i32::from(v >> 8) })
    }

    fn corner(&mut self, place: usize) -> Result<usize, String> {
        let last = self.vertices.len().checked_sub(1);
        let mut position = last.map_or([1024; 3], |last| self.position(last));
        let mut features = last.map_or([128; 2], |last| self.features(last));
        for p in &mut position {
            *p += self.reader.number(Number::Corner, place.min(1))?;
        }
        for feature in &mut features {
            *feature += self.reader.number(Number::Corner, 2)?;
        }
        Ok(self.add(position, stored(features)?))
    }

    fn behind(&mut self, edge: &Edge) -> Result<usize, String> {
        let [a, b, o] = [edge.from, edge.to, edge.opposite].map(|vertex| self.position(vertex));
        let flat = [0, 1, 2].map(|i| (7 * (a[i] + b[i]) - 6 * o[i] + 4) >> 3);
        let side = (0..3).map(|i| (a[i] - b[i]).abs()).max().unwrap_or_default();
        let height = (0..3).map(|i| (a[i] + b[i] - 2 * o[i]).abs()).max().unwrap_or_default();
        let size = bits(side + height / 2).min(11);
        let [na, nb] = [edge.from, edge.to].map(|vertex| self.sums[vertex]);
        let [la, lb] = [na, nb].map(|n| (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]).sqrt());
        let n =
            [0, 1, 2].map(|i| (if la > 0.0 { na[i] / la } else { 0.0 }) + (if lb > 0.0 { nb[i] / lb } else { 0.0 }));
        let z = (1..3).fold(0, |z, axis| if n[axis].abs() > n[z].abs() { axis } else { z });
        let (x, y) = ((z + 1) % 3, (z + 2) % 3);
        let mut p = [0; 3];
        for axis in [x, y] {
            p[axis] = flat[axis] + self.reader.number(Number::Across, size)?;
        }
        let plane =
            |e: [i32; 3]| f64::from(e[z]) - (n[x] * f64::from(p[x] - e[x]) + n[y] * f64::from(p[y] - e[y])) / n[z];
        let mean = ((plane(a) + plane(b)) * 0.5 + 0.5).floor();
        let predicted = if mean.abs() <= 65536.0 { mean as i32 } else { flat[z] };
        p[z] = predicted + self.reader.number(Number::Depth, size)?;
        let (of_a, of_b) = (self.features(edge.from), self.features(edge.to));
        let mut features = [0; 2];
        for (i, model) in [Number::Smoothness, Number::Feature].into_iter().enumerate() {
            let context = bits(of_a[i] - of_b[i]).min(9);
            features[i] = (of_a[i] + of_b[i]).div_euclid(2) + self.reader.number(model, context)?;
        }
        Ok(self.add(p, stored(features)?))
    }

    fn normals(&mut self) -> Result<(), String> {
        let weights = [self.reader.raw(16)?, self.reader.raw(16)?, self.reader.raw(16)?];
        let mut open = vec![false; self.vertices.len()];
        for edge in self.edges.iter().filter(|edge| edge.open) {
            (open[edge.from], open[edge.to]) = (true, true);
        }
        for (vertex, open) in open.into_iter().enumerate() {
            let n = [0, 1, 2].map(|i| self.sums[vertex][i] * f64::from(weights[i]));
            let predicted = octahedral(n);
            for (i, predicted) in predicted.into_iter().enumerate() {
                let difference = self.reader.number(Number::Normal, usize::from(open))?;
                self.vertices[vertex].normal[i] = (predicted + difference) as i8;
            }
        }
        Ok(())
    }
}

fn octahedral(n: [f64; 3]) -> [i32; 2] {
    let sum = n[0].abs() + n[1].abs() + n[2].abs();
    if sum == 0.0 {
        return [0, 0];
    }
    let sign = |v: f64| if v < 0.0 { -1.0 } else { 1.0 };
    let (mut x, mut y) = (n[0] / sum, n[1] / sum);
    if n[2] < 0.0 {
        (x, y) = ((1.0 - y.abs()) * sign(x), (1.0 - x.abs()) * sign(y));
    }
    [x, y].map(|v| (v * 127.0 + 0.5).floor() as i32)
}

fn bits(value: i32) -> usize {
    (32 - value.unsigned_abs().leading_zeros()) as usize
}

fn stored(features: [i32; 2]) -> Result<[u16; 2], String> {
    if features.iter().any(|feature| !(0..=256).contains(feature)) {
        return Err(format!("features {features:?}, expected 0 to 256"));
    }
    Ok(features.map(|feature| if feature == 256 { 65535 } else { (feature as u16) << 8 }))
}
