//! In which order the exact sum over joint events is taken, and what it costs.
//!
//! One side of the cluster, tracks or reports, is scanned item by item; of the other side only those members are
//! remembered, one bit each, that an earlier item could take and a later one still can: the frontier. A layer has 2^w
//! states for a frontier of w bits. Either side may be scanned: with T tracks and M reports, everything gated, the
//! frontier has min(T, M) bits, in a chain two or three.
//!
//! Order: as the items come, if that needs three bits at most or everything is gated. Else from an item at the edge of
//! the cluster (two breadth-first searches find one) always the item that leaves the smallest frontier, among those that
//! touch it. Every member takes the lowest free bit.
//!
//! Reference: H. L. Bodlaender, A tourist guide through treewidth, Acta Cybernetica 11, 1993, for sums over the frontier of
//! a graph.

use super::cluster::Cluster;

/// Layers have at most this many bits.
const WIDEST: usize = 30;

/// What one item of the scan does.
#[derive(Debug)]
pub(super) struct Step {
    pub(super) item: usize,
    /// Bits of this layer.
    pub(super) width: usize,
    /// The members it may take: a range of [`Plan::takes`].
    pub(super) takes: std::ops::Range<usize>,
    /// The members that no later item can take: a range of [`Plan::leaves`], bits decreasing.
    pub(super) leaves: std::ops::Range<usize>,
}

/// An item may take a member of the frontier.
#[derive(Debug, Clone, Copy)]
pub(super) struct Take {
    pub(super) bit: usize,
    pub(super) weight: f64,
    /// Index among the links of the cluster.
    pub(super) link: usize,
}

/// A member leaves the frontier.
#[derive(Debug, Clone, Copy)]
pub(super) struct Leave {
    pub(super) bit: usize,
    pub(super) slot: usize,
}

/// The scan of one cluster.
#[derive(Debug, Default)]
pub(super) struct Plan {
    /// Whether tracks are scanned, or reports.
    pub(super) scans_tracks: bool,
    pub(super) steps: Vec<Step>,
    pub(super) takes: Vec<Take>,
    pub(super) leaves: Vec<Leave>,
    /// Number of transitions between states; `usize::MAX` where a layer is too wide.
    pub(super) transitions: usize,
}

/// The cheapest scan found.
pub(super) fn plan(cluster: &Cluster) -> Plan {
    let links = &cluster.links;
    let by_report = Adjacency::new(cluster.reports, links.len(), |link| links[link].report);
    let by_track = Adjacency::new(cluster.tracks.len(), links.len(), |link| links[link].track);
    let mut best: Option<Plan> = None;
    for scans_tracks in [false, true] {
        let sides = Sides {
            cluster,
            scans_tracks,
            items: if scans_tracks { &by_track } else { &by_report },
            slots: if scans_tracks { &by_report } else { &by_track },
        };
        let mut plan = sides.plan(0..sides.items.nodes());
        // Three bits: there is nothing to gain.
        if plan.transitions <= 4 * links.len() {
            return plan;
        }
        if links.len() < cluster.reports * cluster.tracks.len() {
            let other = sides.plan(sides.order().into_iter());
            if other.transitions < plan.transitions {
                plan = other;
            }
        }
        if best.as_ref().is_none_or(|best| plan.transitions < best.transitions) {
            best = Some(plan);
        }
    }
    best.unwrap_or_default() // never: two were made
}

/// A list of link indices per node, nodes one after the other.
struct Adjacency {
    starts: Vec<usize>,
    links: Vec<usize>,
}

impl Adjacency {
    fn new(nodes: usize, count: usize, node_of: impl Fn(usize) -> usize) -> Self {
        let mut starts = vec![0; nodes + 2];
        for link in 0..count {
            starts[node_of(link) + 2] += 1;
        }
        for node in 2..starts.len() {
            starts[node] += starts[node - 1];
        }
        let mut links = vec![0; count];
        for link in 0..count {
            let next = &mut starts[node_of(link) + 1];
            links[*next] = link;
            *next += 1;
        }
        starts.pop();
        Self { starts, links }
    }

    fn of(&self, node: usize) -> &[usize] {
        &self.links[self.starts[node]..self.starts[node + 1]]
    }

    fn nodes(&self) -> usize {
        self.starts.len() - 1
    }
}

struct Sides<'a> {
    cluster: &'a Cluster,
    scans_tracks: bool,
    items: &'a Adjacency,
    slots: &'a Adjacency,
}

impl Sides<'_> {
    fn item(&self, link: usize) -> usize {
        let link = &self.cluster.links[link];
        if self.scans_tracks { link.track } else { link.report }
    }

    fn slot(&self, link: usize) -> usize {
        let link = &self.cluster.links[link];
        if self.scans_tracks { link.report } else { link.track }
    }

    /// The item found last from `start` by breadth-first search.
    fn farthest(&self, start: usize) -> usize {
        let mut seen = vec![false; self.items.nodes()];
        let mut seen_slot = vec![false; self.slots.nodes()];
        let mut queue = vec![start];
        seen[start] = true;
        let mut head = 0;
        while head < queue.len() {
            for &link in self.items.of(queue[head]) {
                let slot = self.slot(link);
                if std::mem::replace(&mut seen_slot[slot], true) {
                    continue;
                }
                for &other in self.slots.of(slot) {
                    let item = self.item(other);
                    if !std::mem::replace(&mut seen[item], true) {
                        queue.push(item);
                    }
                }
            }
            head += 1;
        }
        queue[head - 1]
    }

    fn order(&self) -> Vec<usize> {
        let (items, slots) = (self.items.nodes(), self.slots.nodes());
        let mut order = Vec::with_capacity(items);
        let mut left: Vec<usize> = (0..slots).map(|slot| self.slots.of(slot).len()).collect();
        let mut open = vec![false; slots];
        let mut known = vec![false; items];
        let mut near = vec![self.farthest(self.farthest(0))];
        known[near[0]] = true;
        while !near.is_empty() {
            let mut best = (i64::MAX, 0);
            for (position, &item) in near.iter().enumerate() {
                let mut growth = 0;
                for &link in self.items.of(item) {
                    let slot = self.slot(link);
                    growth += i64::from(!open[slot]) - i64::from(left[slot] == 1);
                }
                if growth < best.0 {
                    best = (growth, position);
                }
            }
            // `remove` and not `swap_remove`: among equals the one seen first, which keeps the front together.
            let item = near.remove(best.1);
            order.push(item);
            for &link in self.items.of(item) {
                let slot = self.slot(link);
                left[slot] -= 1;
                if std::mem::replace(&mut open[slot], true) {
                    continue;
                }
                for &other in self.slots.of(slot) {
                    let next = self.item(other);
                    if !std::mem::replace(&mut known[next], true) {
                        near.push(next);
                    }
                }
            }
        }
        order
    }

    fn plan(&self, order: impl ExactSizeIterator<Item = usize>) -> Plan {
        let links = &self.cluster.links;
        let mut plan = Plan {
            scans_tracks: self.scans_tracks,
            steps: Vec::with_capacity(order.len()),
            takes: Vec::with_capacity(links.len()),
            leaves: Vec::with_capacity(self.slots.nodes()),
            transitions: 0,
        };
        let mut left: Vec<usize> = (0..self.slots.nodes()).map(|slot| self.slots.of(slot).len()).collect();
        let mut bits = vec![usize::MAX; left.len()];
        let mut used: u64 = 0;
        for item in order {
            let (first_take, first_leave) = (plan.takes.len(), plan.leaves.len());
            for &link in self.items.of(item) {
                let slot = self.slot(link);
                if bits[slot] == usize::MAX {
                    bits[slot] = used.trailing_ones() as usize;
                    if bits[slot] >= WIDEST {
                        plan.transitions = usize::MAX;
                        return plan;
                    }
                    used |= 1 << bits[slot];
                }
                plan.takes.push(Take {
                    bit: bits[slot],
                    weight: links[link].weight,
                    link,
                });
            }
            let width = (u64::BITS - used.leading_zeros()) as usize;
            for &link in self.items.of(item) {
                let slot = self.slot(link);
                left[slot] -= 1;
                if left[slot] == 0 {
                    plan.leaves.push(Leave { bit: bits[slot], slot });
                    used &= !(1 << bits[slot]);
                }
            }
            plan.leaves[first_leave..].sort_unstable_by_key(|leave| std::cmp::Reverse(leave.bit));
            let takes = plan.takes.len() - first_take;
            plan.transitions = plan.transitions.saturating_add((takes << width) / 2);
            plan.steps.push(Step {
                item,
                width,
                takes: first_take..plan.takes.len(),
                leaves: first_leave..plan.leaves.len(),
            });
        }
        plan
    }
}
