//! Families of hosts: a host, and the hosts that are marked files of it.
//!
//! The sketch of a marked file depends on the mark that it carries. If such a host were listed by
//! its own sketch, the rank of the older host on a short list, or whether it is listed at all,
//! would depend on the codewords of the older host's records: through the number of hosts that
//! share its parts, through the order, and through the cut at the end. But the error share of a
//! record must not depend on the record's codeword. So a family has one rank on the list, by the
//! sketch of its eldest host, which carries no mark of the family. All members are searched at that
//! rank, in order of registration, each with a fixed part of the family's error share
//! (`verify::shortlist`). A host that carries marks of several families belongs to the family of
//! the eldest host.
//!
//! Descent follows from the records, which name the marks that their hosts carried. Must not know
//! how hosts are compared.

use std::collections::HashMap;

use super::hosts::HostKey;

/// The hosts in order of registration, and the hosts that each descends from.
#[derive(Debug, Default)]
pub(super) struct Families {
    /// The position of each host in the order of registration.
    order: HashMap<HostKey, u64>,
    next: u64,
    /// For each host, the hosts whose marks it carried, in the index or not.
    parents: HashMap<HostKey, Vec<HostKey>>,
}

impl Families {
    /// Notes that `host` descends from `from`.
    pub(super) fn descends(&mut self, host: HostKey, from: HostKey) {
        let parents = self.parents.entry(host).or_default();
        if host != from && !parents.contains(&from) {
            parents.push(from);
        }
    }

    /// Adds a host, after all hosts that are in the index.
    pub(super) fn insert(&mut self, host: HostKey) {
        if !self.order.contains_key(&host) {
            self.order.insert(host, self.next);
            self.next += 1;
        }
    }

    /// Removes a host. Hosts that descend from it still descend from its parents.
    pub(super) fn remove(&mut self, host: HostKey) {
        self.order.remove(&host);
    }

    /// The position of a host in the order of registration.
    pub(super) fn place(&self, host: HostKey) -> u64 {
        self.order.get(&host).copied().unwrap_or(u64::MAX)
    }

    /// The eldest host in the index that `host` descends from; `host` itself if there is none.
    pub(super) fn eldest(&self, host: HostKey) -> HostKey {
        let (mut seen, mut at) = (vec![host], 0);
        while let Some(next) = seen.get(at) {
            for parent in self.parents.get(next).into_iter().flatten() {
                if !seen.contains(parent) {
                    seen.push(*parent);
                }
            }
            at += 1;
        }
        seen.into_iter().min_by_key(|&host| self.place(host)).unwrap_or(host)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn key(k: u8) -> HostKey {
        HostKey::new(&[k; 32])
    }

    #[test]
    fn a_family_is_called_by_its_eldest_host_that_is_there() {
        let mut families = Families::default();
        for host in [1, 2, 3, 4, 5] {
            families.insert(key(host));
        }
        // 3 is a marked file of 1; 4 is one of 3 and of 2; 2 and 5 are marked files of no host.
        families.descends(key(3), key(1));
        families.descends(key(4), key(2));
        families.descends(key(4), key(3));
        families.descends(key(4), key(4));
        let eldest = |families: &Families, host| families.eldest(key(host));
        for (host, expected) in [(1, 1), (2, 2), (3, 1), (4, 1), (5, 5)] {
            assert_eq!(eldest(&families, host), key(expected), "{host}");
        }
        families.remove(key(1));
        for (host, expected) in [(2, 2), (3, 3), (4, 2)] {
            assert_eq!(eldest(&families, host), key(expected), "{host}");
        }
        // A host that is inserted again is the youngest. A cycle of descent ends.
        families.insert(key(1));
        families.descends(key(1), key(4));
        assert_eq!((eldest(&families, 3), eldest(&families, 1)), (key(2), key(2)));
    }
}
